"""Readers and writers of the users' files: run folders, track folders, shots, table profiles, predictions, gaps.

Videos are read and written in `video.io`, pages and recordings in `pipeline.reporting`.
"""
