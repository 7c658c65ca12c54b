"""Strengths that differ between bodies: each body's own under a common prior, and predictions with them."""
