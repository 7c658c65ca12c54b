"""Sentences about shots, fits and diagnoses, and the choice of what they name; HTML pages are in `reporting.pages`."""
