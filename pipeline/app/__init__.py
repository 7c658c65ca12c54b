"""The page instead of the command line: a library of shots, a queue of clips, and the server of both."""
