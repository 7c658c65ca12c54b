"""Curves through measured positions, without physics: linear, and not-a-knot cubic."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray

LONGEST_SMOOTH_GAP = 2.5
"""typical intervals between samples: over wider gaps a cubic overshoots, so the curve is straight there."""


def linear_pieces(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Coefficients (T-1, 4, 2) of powers of t - t[k] of the polygon through xy (T, 2) at t (T,)."""
    slope = np.diff(xy, axis=0) / np.diff(t)[:, None]
    zero = np.zeros_like(slope)
    return np.stack([xy[:-1], slope, zero, zero], axis=1)


def cubic_pieces(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Coefficients (T-1, 4, 2) of the not-a-knot cubic spline through xy (T, 2), straight over gaps."""
    if len(t) < 4:
        return linear_pieces(t, xy)
    from scipy.interpolate import CubicSpline  # slow to import, and not needed where physics accepts all

    pieces = np.moveaxis(CubicSpline(t, xy, bc_type="not-a-knot").c[::-1], 0, 1)  # (T-1, 4, 2)
    step = np.diff(t)
    wide = step > LONGEST_SMOOTH_GAP * np.median(step)
    return np.where(wide[:, None, None], linear_pieces(t, xy), pieces)


def smooth_pieces(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Break points (M+1,) and coefficients (M, 4, 2) of the smoothest cubic that keeps to samples within their errors.

    Straight lines between samples where a gap is wide, so that nothing is invented there. Shapes: t (T,), xy (T, 2),
    sigma (T,) m.
    """
    step = np.diff(t)
    if len(t) < 6 or np.any(step > LONGEST_SMOOTH_GAP * np.median(step)):
        return t, cubic_pieces(t, xy)
    from scipy.interpolate import PPoly, UnivariateSpline

    curves = [PPoly.from_spline(UnivariateSpline(t, xy[:, k], w=1 / sigma, s=len(t))._eval_args) for k in (0, 1)]
    breaks = np.unique(np.concatenate([curve.x for curve in curves]))
    breaks = breaks[(breaks >= t[0]) & (breaks <= t[-1])]
    orders = [
        [curve.derivative(k)(breaks[:-1]) / (1, 1, 2, 6)[k] if k else curve(breaks[:-1]) for k in range(4)]
        for curve in curves
    ]
    return breaks, np.moveaxis(np.array(orders), (0, 1, 2), (2, 1, 0))
