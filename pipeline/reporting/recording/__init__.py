"""Recordings for the rerun viewer: layers, blueprint, live stream, and the viewer process."""
