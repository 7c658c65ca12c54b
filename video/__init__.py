"""Pixels and time: reading, writing, the table in the picture, in-between frames, drawing."""
