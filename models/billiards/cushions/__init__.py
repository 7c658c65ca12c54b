"""Ball against cushion: one file per published law."""
