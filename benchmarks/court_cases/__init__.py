"""Rendered rallies for `benchmarks.courts`: cases, what the program answers, bounds and scores."""
