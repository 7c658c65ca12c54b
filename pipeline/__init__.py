"""The program: stages, their graph and cache, batches, reports and the command line.

Estimation, detection, video and diagnosis are in the packages `models`, `detectors`, `video` and `diagnosis`.
"""
