"""Training, evaluation and export of the detection networks. Needs the `train` extra."""
