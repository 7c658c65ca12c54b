"""Sentences about shots, fits and diagnoses; their HTML pages are in `reporting.pages`."""
