"""Place and streak of a spot from the moments of its change."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.flying.motion_spots import Spots
from models.core.typing import ByteArray, FloatArray

# Half the side, working px, of the square that is measured, and the share of the peak that belongs to the spot.
REACH_PX, PEAK_SHARE = 20, 0.35


@dataclass(frozen=True, slots=True)
class SpotMeasures:
    """Places of K spots, in px of the image that was searched."""

    centre: FloatArray
    """(K, 2)"""
    streak: FloatArray
    """(K, 2)"""
    score: FloatArray
    """(K,)"""
    sigma: FloatArray
    """(K, 2) across and along the streak."""


def measure_moments(change: ByteArray, spots: Spots) -> SpotMeasures:
    """Measure spots by the moments of the connected change around each."""
    smooth = cv2.blur(change, (3, 3))
    rows = [_measure_spot(smooth, int(x), int(y)) for x, y in spots.place]
    moments = np.array(rows, np.float64).reshape(-1, 4)
    length = np.linalg.norm(moments[:, 2:], axis=1)
    score = 1 / (1 + np.exp(3.0 - spots.distinctness))
    sigma = np.column_stack([np.full(len(rows), 0.7), 0.7 + length / 8])
    return SpotMeasures(moments[:, :2], moments[:, 2:], score, sigma)


def _measure_spot(smooth: ByteArray, x: int, y: int) -> tuple[float, float, float, float]:
    """Measure centre and streak of the spot at a px."""
    left, top = max(x - REACH_PX, 0), max(y - REACH_PX, 0)
    part = smooth[top : y + REACH_PX + 1, left : x + REACH_PX + 1]
    level = int(PEAK_SHARE * part[y - top, x - left])
    _, labels = cv2.connectedComponents((part > level).astype(np.uint8))
    label = labels[y - top, x - left]
    if label == 0:
        return float(x), float(y), 0.0, 0.0
    v, u = np.nonzero(labels == label)
    weight = part[v, u].astype(np.float64)
    weight /= weight.sum()
    centre = np.array([weight @ u, weight @ v])
    off = np.column_stack([u, v]) - centre
    values, vectors = np.linalg.eigh((off * weight[:, None]).T @ off)
    # An even streak of length L adds L^2 / 12 to the variance along it.
    streak = np.sqrt(12 * max(values[1] - values[0], 0.0)) * vectors[:, 1]
    return left + centre[0], top + centre[1], float(streak[0]), float(streak[1])
