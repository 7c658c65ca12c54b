"""Contact of two balls: one file per published model."""
