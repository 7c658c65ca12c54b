"""Benchmarks of in-between frames."""
