"""Cubic pieces of a trajectory from the polynomial pieces of a simulated path."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from models.core.typing import FloatArray
from models.physics.billiards.cloth.motion_pieces import PIECE_END, PIECE_START, REST_DURATION, WX, WY, X, Y

_CUBIC_TOLERANCE = 1e-8
"""m; greatest error of a cubic of a trajectory on a path that is no cubic."""


def split_into_cubics(row: FloatArray, spin: FloatArray) -> list[tuple[float, float, FloatArray, FloatArray]]:
    """Split a piece of degree five into cubics: start, end (s), position (4, 2), spin (2, 3) of each."""
    x = np.stack([row[X : X + 6], row[Y : Y + 6]], axis=1)
    w = np.stack([row[WX : WX + 5], row[WY : WY + 5]], axis=1)
    length = min(float(row[PIECE_END] - row[PIECE_START]), REST_DURATION)
    bend = np.abs(24 * x[4]).max() + 120 * np.abs(x[5]).max() * length
    parts = max(1, int(np.ceil((bend * length**4 / 384 / _CUBIC_TOLERANCE) ** 0.25)))
    times = set(np.linspace(0, length, parts + 1))
    if spin[1] and abs(spin[0]) < abs(spin[1]) * length:
        times.add(float(abs(spin[0] / spin[1])))
    ends = sorted(times)
    return [
        (
            float(row[PIECE_START] + a),
            float(row[PIECE_START] + b),
            _fit_cubic(x, a, b),
            _interpolate_spin(w, spin, a, b),
        )
        for a, b in pairwise(ends)
        if b - a > 1e-12
    ]


def _fit_cubic(x: FloatArray, a: float, b: float) -> FloatArray:
    """Fit position coefficients (4, 2) from a to b (s) to place and velocity of x (6, 2) at both ends.

    The result is exact where x is a cubic.
    """
    (p0, v0), (p1, v1) = (_value_and_rate(x, t) for t in (a, b))
    h = b - a
    if not np.any(x[3:]):
        return np.array([p0, v0, x[2], np.zeros(2)])
    mean = (p1 - p0) / h
    return np.array([p0, v0, (3 * mean - 2 * v0 - v1) / h, (v0 + v1 - 2 * mean) / h**2])


def _interpolate_spin(w: FloatArray, spin: FloatArray, a: float, b: float) -> FloatArray:
    """Interpolate the spin linearly from a to b (s): coefficients (2, 3) of wx, wy, wz."""
    (w0, _), (w1, _) = (_value_and_rate(w, t) for t in (a, b))
    left = [max(abs(spin[0]) - abs(spin[1]) * t, 0.0) * np.sign(spin[0]) for t in (a, b)]
    first, last = np.append(w0, left[0]), np.append(w1, left[1])
    return np.array([first, (last - first) / (b - a)])


def _value_and_rate(c: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
    """Evaluate a polynomial (K, D) and its derivative at t (s)."""
    powers = t ** np.arange(len(c))
    return powers @ c, (np.arange(1, len(c)) * powers[:-1]) @ c[1:]
