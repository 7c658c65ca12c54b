"""Fit of a shot from end to end: tracks in, events and motion between frames out."""
