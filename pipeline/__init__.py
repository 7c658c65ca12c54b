"""A clip goes in, files come out: stages, their graph, the cache and the command line."""
