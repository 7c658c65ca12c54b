"""The runner of stage graphs: stages, their order, the cache of results, executors and atomic writing of files.

The stages themselves are in `pipeline.stages`.
"""
