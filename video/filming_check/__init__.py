"""Measurements of how well a clip is filmed, before it is processed."""
