"""Tracks to a fit: the story of a shot, its contacts, its motion between them, and how far to trust it."""
