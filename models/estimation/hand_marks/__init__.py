"""Contacts that a person marked, moved or deleted: strong priors of the fit, and what the motion says about them."""
