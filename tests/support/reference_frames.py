"""Frames of reference of recordings of any motion, by their number of coordinates."""

from __future__ import annotations

from models.core.recording import ReferenceFrame

LINE, PLANE, SPACE = FRAMES = tuple(
    ReferenceFrame(("x", "y", "z")[:count], "m", "in the laboratory") for count in (1, 2, 3)
)
ROD = ReferenceFrame(("theta1",), "rad", "from the vertical")
