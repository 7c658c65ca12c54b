"""Benchmarks of the DAG runner, batches and recordings."""
