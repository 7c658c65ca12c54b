"""Detections to tracks: which detection is which ball, and what each ball is called."""
