"""Curves through measured positions, without physics: linear, and not-a-knot cubic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.float64]

LONGEST_SMOOTH_GAP = 2.5
"""typical intervals between samples: over wider gaps a cubic overshoots, so the curve is straight there."""


def linear_pieces(t: Floats, xy: Floats) -> Floats:
    """Coefficients (T-1, 4, 2) of powers of t - t[k] of the polygon through xy (T, 2) at t (T,)."""
    slope = np.diff(xy, axis=0) / np.diff(t)[:, None]
    zero = np.zeros_like(slope)
    return np.stack([xy[:-1], slope, zero, zero], axis=1)


def cubic_pieces(t: Floats, xy: Floats) -> Floats:
    """Coefficients (T-1, 4, 2) of the not-a-knot cubic spline through xy (T, 2), straight over gaps."""
    if len(t) < 4:
        return linear_pieces(t, xy)
    pieces = np.moveaxis(CubicSpline(t, xy, bc_type="not-a-knot").c[::-1], 0, 1)  # (T-1, 4, 2)
    step = np.diff(t)
    wide = step > LONGEST_SMOOTH_GAP * np.median(step)
    return np.where(wide[:, None, None], linear_pieces(t, xy), pieces)
