"""The DAG runner: stages, their graph, the cache of results, and atomic writing."""
