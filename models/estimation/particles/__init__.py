"""Particles of which only coordinates are known: the model that explains them, and a prediction."""
