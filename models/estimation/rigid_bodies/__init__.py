"""Inference of rigid bodies and their world from points that are fixed to them."""
