"""The editor of a run: a page on this machine, its server, and the runs that follow each correction.

The corrections themselves are in `models.core.corrections`, their file is in `pipeline.io.corrections_file`.
"""
