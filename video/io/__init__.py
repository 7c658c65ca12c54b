"""Reading and writing of clips, images and sound, and conversions between pixel formats."""
