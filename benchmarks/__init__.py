"""Scripts that print the figures of the README and the documentation. `benchmarks/README.md` lists them.

Run one from the root of the repository, for example `python -m benchmarks.clips.samples`.
"""
