"""Input and output of video, images and audio, and conversions between pixel formats; no analysis of the content."""
