"""Benchmarks of the whole chain on sample clips and real clips."""
