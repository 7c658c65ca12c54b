"""Detections to tracks: which detection belongs to which ball, and the class of every ball.

Detection from pixels lives in `detectors`, the fit of physics to tracks in `models.estimation`.
"""
