"""Particles of which only coordinates are known: what explains them, and where they will be."""
