"""Where a detector saw balls: one row per ball and picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class Detections:
    """K detections in columns, sorted by frame; pixels of the original upright picture.

    `centre` is the place at mid-exposure. A sharp ball has a `streak` of (0, 0).
    """

    frame: NDArray[np.int64]
    """(K,) picture in presentation order."""
    centre: FloatArray
    """(K, 2) px."""
    radius: FloatArray
    """(K,) px."""
    streak: FloatArray
    """(K, 2) px: the way travelled during the exposure, sign unknown."""
    colour: FloatArray
    """(K, 3) CIE L*a*b* of the ball without its highlight."""
    white: FloatArray
    """(K,) share of the disc that is white: near 1 cue ball, 0.2 to 0.7 a stripe."""
    white_rim: FloatArray
    """(K,) the same of its outer ring, where a stripe is white and hardly any number."""
    value: FloatArray
    """(K,) in [0, 1]: brightest of the colour channels where it is not white (HSV); only black is dark in all."""
    score: FloatArray
    """(K,) in [0, 1]."""
    sigma: FloatArray
    """(K,) px, one standard deviation per axis, across the streak."""
    sigma_along: FloatArray
    """(K,) px, along the streak; equals `sigma` for sharp balls."""

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
