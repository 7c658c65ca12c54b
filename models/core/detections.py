"""Output of a detector: one row per detected ball and frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.array_columns import take_rows
from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Detections:
    """K detections in columns, sorted by frame.

    Coordinates are pixels of the original frame in upright orientation: x to the right, y down. A moving ball leaves a
    motion-blur streak; a sharp ball has a `streak` of (0, 0).
    """

    frame: NDArray[np.int64]
    """(K,) index of the frame in presentation order, from 0."""
    centre: FloatArray
    """(K, 2) px, centre of the ball at mid-exposure."""
    radius: FloatArray
    """(K,) px, radius of the ball in the image."""
    streak: FloatArray
    """(K, 2) px, displacement during the exposure; its sign is unknown."""
    colour: FloatArray
    """(K, 3) CIE L*a*b*, colour of the ball without its highlight."""
    white: FloatArray
    """(K,) white share of the disc, 0 to 1: near 1 for a cue ball, 0.2 to 0.7 for a stripe."""
    white_rim: FloatArray
    """(K,) white share of the outer ring, 0 to 1. A stripe is white there; a printed number seldom reaches it."""
    value: FloatArray
    """(K,) HSV value (largest colour channel) of the part that is not white, 0 to 1; low for a black ball only."""
    score: FloatArray
    """(K,) confidence score, 0 to 1."""
    sigma: FloatArray
    """(K,) px, standard deviation of the centre across the streak."""
    sigma_along: FloatArray
    """(K,) px, standard deviation of the centre along the streak; equals `sigma` for sharp balls."""

    def __post_init__(self) -> None:
        k = len(self.frame)
        for name, width in (("centre", 2), ("streak", 2), ("colour", 3)):
            if getattr(self, name).shape != (k, width):
                raise ValueError(f"Detections.{name} must be ({k}, {width}); got {getattr(self, name).shape}")
        for name in ("radius", "white", "white_rim", "value", "score", "sigma", "sigma_along"):
            if getattr(self, name).shape != (k,):
                raise ValueError(f"Detections.{name} must be ({k},); got {getattr(self, name).shape}")
        if k and np.any(np.diff(self.frame) < 0):
            raise ValueError("Detections must be sorted by frame")

    def __len__(self) -> int:
        return len(self.frame)

    def select_rows(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Detections:
        """Return the detections of a mask (K,) or of rows in their order."""
        return take_rows(self, rows)


@dataclass(frozen=True, slots=True)
class MarkedDetections:
    """Detections with the balls that a person placed."""

    detections: Detections
    mark: NDArray[np.int64]
    """(K,) number of the mark that a detection was placed by; -1 for those of the detector."""
