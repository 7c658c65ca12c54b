"""Tracks cut into segments of motion, and the causes of the cuts."""
