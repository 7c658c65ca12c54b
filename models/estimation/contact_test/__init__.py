"""Did two bodies touch: competing hypotheses about one moment, and the answers to calls."""
