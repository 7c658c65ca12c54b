"""Effects of the camera: they change what is observed, not the motion."""
