"""The stages of a run, one file each: a few lines that connect a package below to the stage graph.

`pipeline.chain` combines them; `pipeline.engine` runs them.
"""
