"""Benchmarks of learnt methods and the thesis."""
