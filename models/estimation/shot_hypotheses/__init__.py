"""Weights of the hypotheses of a shot: how probable each event, rival cause and unexplained change is."""
