"""Fast balls: during the exposure a disc sweeps a capsule, as wide as the ball and longer the faster it is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.cloth import Floats32
from detectors.view import View

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_STRETCH = 0.5
"""Streak over radius from which a blob counts as one; shorter ones are measured as discs."""
LONGEST_RADII = 26.0
"""A ball at 10 m/s that is exposed for 1/15 s moves about 23 radii."""
WIDTH_BAND = (0.72, 1.5)
"""Width of the blob over the ball's, between which it is a ball."""
LEAST_WAIST = 0.7
"""Least width of the blob between its round ends, over its width: two balls that touch have a waist."""
LEAST_FILL = 0.80
"""Least part of the capsule that the blob covers, and of the blob that the capsule covers."""


@dataclass(frozen=True, slots=True)
class Streaks:
    """K capsules, working px."""

    centre: Floats
    """(K, 2) middle of the streak: the place at mid-exposure."""
    vector: Floats
    """(K, 2) from one end's disc to the other's, sign unknown."""
    radius: Floats
    """(K,)"""
    fill: Floats
    """(K,) overlap of blob and capsule over their union."""


def find_streaks(moving: Bools, strength: Floats32, view: View) -> Streaks:
    """Capsules among the blobs of what differs from both the cloth and the median picture."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8), connectivity=8)
    found = []
    least = 0.5 * np.pi * float(view.radius.min()) ** 2
    for blob in range(1, count):
        x, y, w, h, area = stats[blob]
        if area < least or max(w, h) > (LONGEST_RADII + 2) * float(view.radius.max()):
            continue
        capsule = _capsule(labels[y : y + h, x : x + w] == blob, np.array([x, y]), view)
        if capsule is not None:
            found.append(capsule)
    if not found:
        return Streaks(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0))
    centre, vector, radius, fill = (np.array(column) for column in zip(*found, strict=True))
    return Streaks(centre, vector, radius, fill)


def _capsule(blob: Bools, corner: NDArray[np.int64], view: View) -> tuple[Floats, Floats, float, float] | None:
    """The capsule of the expected width that covers a blob (h, w), None where it is another shape."""
    points = np.column_stack(np.nonzero(blob)[::-1]).astype(np.float64) + corner
    middle = points.mean(axis=0)
    u, v = np.clip(np.rint(middle).astype(int), 0, np.array(view.radius.shape[::-1]) - 1)
    radius = float(view.radius[v, u])
    _, axes = np.linalg.eigh(np.cov((points - middle).T))
    along, across = axes[:, 1], axes[:, 0]
    reach, width = _extent((points - middle) @ along), _extent((points - middle) @ across)
    length = (reach[1] - reach[0]) - (width[1] - width[0])
    ratio = (width[1] - width[0]) / (2 * radius)
    if length < LEAST_STRETCH * radius or not WIDTH_BAND[0] < ratio < WIDTH_BAND[1] or not view.centres[v, u]:
        return None
    if _waist((points - middle) @ along, reach, 2 * radius * ratio) < LEAST_WAIST:
        return None
    centre = middle + along * sum(reach) / 2 + across * sum(width) / 2
    fill = _overlap(points, centre, along * length, radius * ratio)
    return (centre, along * length, radius, fill) if fill > LEAST_FILL else None


def _waist(along: Floats, reach: tuple[float, float], width: float) -> float:
    """Least width between the round ends of points (n,) along the axis, over the width."""
    bins = np.arange(reach[0] + width / 2, reach[1] - width / 2 + 2.0, 2.0)
    if len(bins) < 2:
        return 1.0
    return float(np.histogram(along, bins)[0].min() / (2.0 * width))


def _extent(along: Floats) -> tuple[float, float]:
    """Both ends of points (n,), pixel edges included, single stray pixels left out."""
    low, high = np.quantile(along, (0.004, 0.996))
    return float(low) - 0.5, float(high) + 0.5


def _overlap(points: Floats, centre: Floats, vector: Floats, radius: float) -> float:
    """Intersection over union of pixels (n, 2) and a capsule."""
    length = float(np.linalg.norm(vector))
    at = points - centre
    along = np.clip(at @ vector / max(length, 1e-9), -length / 2, length / 2)
    beside = np.linalg.norm(at - along[:, None] * vector / max(length, 1e-9), axis=1)
    inside = float((beside < radius + 0.5).sum())
    area = np.pi * radius**2 + 2 * radius * length
    return inside / (area + len(points) - inside)
