"""The editor of a run: a page on this machine, its server, and the runs that follow each correction.

The corrections themselves and their file are in `models.core.corrections` and `pipeline.io.corrections_file`.
"""
