"""Benchmarks of the diagnosis of the sim-to-real gap."""
