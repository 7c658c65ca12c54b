"""Synthetic images with exact truth: scenes, their renderer, and training images; no drawing into real frames."""
