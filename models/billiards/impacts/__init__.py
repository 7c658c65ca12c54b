"""Ball against ball: one file per published law."""
