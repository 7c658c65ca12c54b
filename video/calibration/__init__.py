"""Table localisation, camera calibration, segmentation of recordings into shots; balls are detected in `detectors`."""
