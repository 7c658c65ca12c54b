"""Sentences about shots, fits and diagnoses."""
