"""Output frames and images: annotated slow motion, plain interpolation, close-ups, replays and posters."""
