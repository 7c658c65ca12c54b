"""Benchmarks of detectors."""
