"""Billiards: tables, parameters, motion on the cloth, contacts and simulation. Fits live in `models.estimation`."""
