"""The files that a user reads and writes: run folders, track folders, shots, profiles, predictions."""
