"""Segmentation of tracks into segments of motion, and the contacts between them."""
