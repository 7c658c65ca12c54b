"""Benchmarks of tracking and breaks."""
