"""Dataclasses whose fields are columns."""
