"""The program: its entry point, its error handling, and its commands."""
