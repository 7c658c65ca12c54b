"""Ball detection: from images to `Detections`, with a standard deviation for every centre.

The detectors (`hough`, `network`), the measurements they share (`measurement`) and the training of the networks
(`training`). Tracking and naming of balls are in `models.tracking`; decoding and camera calibration in `video`.
"""
