"""The renderer of test and training scenes, and the scenes themselves."""
