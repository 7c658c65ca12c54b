"""The command line program: its entry point, its error handling, and its commands.

Work that needs no terminal is in `pipeline.actions`, `pipeline.chain` and `pipeline.batch`.
"""
