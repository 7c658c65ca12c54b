"""Appearance of balls over many frames, from which their classes are determined."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.typing import FloatArray, IntArray

# Of two balls whose centres are nearer than this many radii, one hides part of the other.
MIN_CLEARANCE = 1.9
# Unoccluded detections of a ball from which the occluded ones are ignored.
MIN_CLEAR_DETECTIONS = 5


@dataclass(frozen=True, slots=True)
class Appearance:
    """Appearance of N balls, averaged over many frames."""

    colour: FloatArray
    """(N, 3) median CIE L*a*b*."""
    white: FloatArray
    """(N,) median white share."""
    white_high: FloatArray
    """(N,) 90th percentile of the white share of a rolling ball, since a stripe shows its white only now and then; the
    median of a resting one.
    """
    white_rim: FloatArray
    """(N,) median white share of the outer ring."""
    value: FloatArray
    """(N,) median of the brightest channel, 0 to 1, where it is not white."""

    @property
    def chroma(self) -> FloatArray:
        """(N,) distance from grey."""
        return np.hypot(self.colour[:, 1], self.colour[:, 2])


def summarize_appearance(colours: list[FloatArray], rows: list[IntArray], detections: Detections) -> Appearance:
    """Summarize the appearance of N balls over their detections.

    Args:
        colours: N mean colours (3,), CIE L*a*b*.
        rows: N arrays with the rows of `detections` that belong to each ball.
        detections: All detections of the clip.

    Returns:
        The appearance of the N balls. Occluded detections are ignored where enough others exist.
    """
    is_clear = _is_unoccluded(detections)
    selected = [row[is_clear[row]] if is_clear[row].sum() >= MIN_CLEAR_DETECTIONS else row for row in rows]
    white, rim, value = detections.white, detections.white_rim, detections.value
    return Appearance(
        np.array(colours),
        np.array([np.median(white[row]) for row in selected]),
        np.array([np.percentile(white[row], 90 if _leaves_its_place(detections, row) else 50) for row in selected]),
        np.array([np.median(rim[row]) for row in selected]),
        np.array([np.median(value[row]) for row in selected]),
    )


def _leaves_its_place(detections: Detections, row: IntArray) -> bool:
    """Return whether a ball moves by more than its radius."""
    return bool(np.ptp(detections.centre[row], axis=0).max() > detections.radius[row].max())


def _is_unoccluded(detections: Detections) -> NDArray[np.bool_]:
    """Mark the detections (K,) that no other detection of the same frame overlaps."""
    is_clear = np.ones(len(detections), dtype=bool)
    ends = np.flatnonzero(np.diff(detections.frame, prepend=-1, append=np.iinfo(np.int64).max))
    for first, last in pairwise(ends):
        centre, radius = detections.centre[first:last], detections.radius[first:last]
        distance = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
        np.fill_diagonal(distance, np.inf)
        is_clear[first:last] = (distance > MIN_CLEARANCE * (radius[:, None] + radius[None]) / 2).all(axis=1)
    return is_clear
