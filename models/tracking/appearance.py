"""How balls look over many pictures: what their kinds are told from."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.typing import FloatArray, IntArray

CLEAR_RADII = 1.9
"""Of two balls whose centres are seen nearer than this many radii, one hides some of the other."""
FEWEST_CLEAR = 5
"""Pictures in which a ball stands clear of the others, from which only those are looked at."""


@dataclass(frozen=True, slots=True)
class Look:
    """How N balls look over many pictures."""

    colour: FloatArray
    """(N, 3) median CIE L*a*b*."""
    white: FloatArray
    """(N,) median white share."""
    white_high: FloatArray
    """(N,) 90th percentile of the white share of a ball that rolls: a stripe shows it now and then. Else the median."""
    white_rim: FloatArray
    """(N,) median white share of the outer ring."""
    value: FloatArray
    """(N,) median of the brightest channel, 0 to 1, where it is not white."""

    @property
    def chroma(self) -> FloatArray:
        """(N,) distance from grey."""
        return np.hypot(self.colour[:, 1], self.colour[:, 2])


def look_of(colours: list[FloatArray], rows: list[IntArray], detections: Detections) -> Look:
    """The look of N balls from their colours (3,) and the rows of `detections` in which each is seen."""
    clear = _clear(detections)
    chosen = [row[clear[row]] if clear[row].sum() >= FEWEST_CLEAR else row for row in rows]
    white, rim, value = detections.white, detections.white_rim, detections.value
    return Look(
        np.array(colours),
        np.array([np.median(white[row]) for row in chosen]),
        np.array([np.percentile(white[row], 90 if _rolls(detections, row) else 50) for row in chosen]),
        np.array([np.median(rim[row]) for row in chosen]),
        np.array([np.median(value[row]) for row in chosen]),
    )


def _rolls(detections: Detections, row: IntArray) -> bool:
    """Whether a ball is seen to leave its place."""
    return bool(np.ptp(detections.centre[row], axis=0).max() > detections.radius[row].max())


def _clear(detections: Detections) -> NDArray[np.bool_]:
    """Which detections (K,) no other one of the same picture covers or is covered by."""
    clear = np.ones(len(detections), dtype=bool)
    ends = np.flatnonzero(np.diff(detections.frame, prepend=-1, append=np.iinfo(np.int64).max))
    for first, last in pairwise(ends):
        centre, radius = detections.centre[first:last], detections.radius[first:last]
        apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        clear[first:last] = (apart > CLEAR_RADII * (radius[:, None] + radius[None]) / 2).all(axis=1)
    return clear
