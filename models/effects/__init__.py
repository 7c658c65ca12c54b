"""What acts on a ball: one effect per file, listed in the catalogue."""
