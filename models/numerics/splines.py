"""Curves through measured positions, without physics: linear, not-a-knot cubic, and smoothing cubic."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray

MAX_SMOOTH_GAP = 2.5
"""Median sample intervals: over wider gaps a cubic overshoots, so the curve is straight there."""


def fit_linear_pieces(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Connect samples by straight lines.

    Args:
        t: Times (T,), s, increasing.
        xy: Positions (T, 2), m.

    Returns:
        Coefficients (T-1, 4, 2) of powers of t - t[k], m/s^k.
    """
    slope = np.diff(xy, axis=0) / np.diff(t)[:, None]
    zero = np.zeros_like(slope)
    return np.stack([xy[:-1], slope, zero, zero], axis=1)


def fit_cubic_pieces(t: FloatArray, xy: FloatArray) -> FloatArray:
    """Fit a not-a-knot cubic spline through samples, with straight lines over wide gaps.

    Args:
        t: Times (T,), s, increasing.
        xy: Positions (T, 2), m.

    Returns:
        Coefficients (T-1, 4, 2) of powers of t - t[k], m/s^k.
    """
    if len(t) < 4:
        return fit_linear_pieces(t, xy)
    from scipy.interpolate import CubicSpline  # slow to import, and not needed if every segment has an accepted fit

    pieces = np.moveaxis(CubicSpline(t, xy, bc_type="not-a-knot").c[::-1], 0, 1)  # (T-1, 4, 2)
    step = np.diff(t)
    wide = step > MAX_SMOOTH_GAP * np.median(step)
    return np.where(wide[:, None, None], fit_linear_pieces(t, xy), pieces)


def fit_smoothing_pieces(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit the smoothest cubic that stays within the errors of the samples.

    If a gap is wide, or there are fewer than six samples, the curve passes through all samples (`fit_cubic_pieces`).

    Args:
        t: Times (T,), s, increasing.
        xy: Positions (T, 2), m.
        sigma: Standard deviations of the positions (T,), m.

    Returns:
        Break points (M+1,) in s, and coefficients (M, 4, 2) of powers of the time since the break point, m/s^k.
    """
    step = np.diff(t)
    if len(t) < 6 or np.any(step > MAX_SMOOTH_GAP * np.median(step)):
        return t, fit_cubic_pieces(t, xy)
    from scipy.interpolate import PPoly, UnivariateSpline

    curves = [PPoly.from_spline(UnivariateSpline(t, xy[:, k], w=1 / sigma, s=len(t))._eval_args) for k in (0, 1)]
    breaks = np.unique(np.concatenate([curve.x for curve in curves]))
    breaks = breaks[(breaks >= t[0]) & (breaks <= t[-1])]
    orders = [
        [curve.derivative(k)(breaks[:-1]) / (1, 1, 2, 6)[k] if k else curve(breaks[:-1]) for k in range(4)]
        for curve in curves
    ]
    return breaks, np.moveaxis(np.array(orders), (0, 1, 2), (2, 1, 0))
