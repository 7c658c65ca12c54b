"""Benchmarks of the fit of shots, contact times, calls and predictions."""
