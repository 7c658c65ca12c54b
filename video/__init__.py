"""Pixels and time: reading and writing clips, calibrating the table, rendering, interpolating and annotating frames.

No physics and no detection: motion comes from `models`, detections from `detectors`.
"""
