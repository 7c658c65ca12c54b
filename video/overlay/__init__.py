"""Annotated slow motion, plain interpolation, close-ups, replays and posters."""
