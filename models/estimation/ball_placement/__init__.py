"""Places of balls on a table at one time, and how they are restored."""
