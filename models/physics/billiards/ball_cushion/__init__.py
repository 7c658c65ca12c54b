"""Contact of a ball with a cushion: one file per published model."""
