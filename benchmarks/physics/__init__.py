"""Benchmarks of the physical models."""
