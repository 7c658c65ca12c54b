"""Work of single commands beyond the chain: calls, interpolation, particles, diagnosis of batches.

Command-line parsing is in `pipeline.cli`, file formats in `pipeline.io`.
"""
