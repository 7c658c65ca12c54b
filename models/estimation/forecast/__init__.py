"""Prediction of the rest of a shot from any moment, with its uncertainty."""
