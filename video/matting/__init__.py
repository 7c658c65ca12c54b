"""Balls cut out of frames and laid over others: background, mattes, deblurring, compositing."""
