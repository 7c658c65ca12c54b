"""What can be chosen where balls are looked for: light to import, the command line is made from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """How balls are looked for."""

    detector: Literal["auto", "hough", "onnx"] = "auto"
    """Which detector: hough needs no network, auto takes the best one there is."""
    model: str | None = None
    """File of an ONNX ball detector, for the onnx detector; the project's own where none is named."""
    quick: bool = False
    """Learn the empty table from fewer pictures."""
