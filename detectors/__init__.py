"""A picture to Detections: where the balls are, with an error for every centre."""
