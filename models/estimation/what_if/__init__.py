"""The same shot played otherwise: ensembles at the strike, changes of the stroke, and what they score."""
