"""Batches: finds the clips below a folder, runs each in a process that may be killed, and summarizes them.

Clips run one after another or on the workers of a Dask cluster. The run of one clip is in `pipeline.chain`.
"""
