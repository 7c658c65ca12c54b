"""When frames of a rally were taken, where the clip shows some of them twice.

A conversion from 25 to 30 fps shows every fifth frame twice. Its distinct frames were taken at even times, and shown
at uneven ones; a camera that lost frames shows them when they were taken. How the object moves tells which it was.
"""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray, IntArray

# Successive places that are compared with a parabola, and so share their errors.
_RUN = 4
# px, departure from a parabola over four places that a flight itself may have, beside the errors of the places.
_BEND = 1.0
# Natural logarithm of the evidence that another clock needs, a thousand to one: the clock of a clip is mostly right.
_LEAST_GAIN = 7.0


def is_uneven(t: FloatArray) -> bool:
    """Return whether times (T,), s, depart from a constant rate by more than a container rounds."""
    return len(t) > 2 and bool(np.abs(np.linspace(t[0], t[-1], len(t)) - t).max() >= np.median(np.diff(t)) / 4)


def estimate_capture_times(rows: IntArray, px: FloatArray, sigma: FloatArray, t: FloatArray) -> FloatArray:
    """Estimate when the frames of a clip were taken.

    Args:
        rows: (N,) frames in which the object is seen.
        px: (N, 2) px, its places in an image that stands still.
        sigma: (N,) px.
        t: (T,) s, at least two, when the distinct frames are shown.

    Returns:
        (T,) s: even times where the motion of the object is smoother at those, else `t`.
    """
    even = np.linspace(t[0], t[-1], len(t))
    first = np.flatnonzero(rows[_RUN - 1 :] - rows[: 1 - _RUN] == _RUN - 1) if len(rows) >= _RUN else rows[:0]
    runs = first[:, None] + np.arange(_RUN)
    costs = [_measure_roughness(clock[rows[runs]], px[runs], sigma[runs]) for clock in (t, even)]
    return even if costs[0] - costs[1] > _LEAST_GAIN else t


def _measure_roughness(t: FloatArray, px: FloatArray, sigma: FloatArray) -> float:
    """Measure by how much places (R, 4, 2) at times (R, 4) depart from parabolas: a robust negative log-likelihood."""
    gaps = t[:, :, None] - t[:, None, :] + np.eye(_RUN)
    weights = 1 / gaps.prod(axis=2)  # of the divided difference of third order
    weights /= np.abs(weights).max(axis=1, keepdims=True)
    square = (np.einsum("rk,rki->ri", weights, px) ** 2).sum(axis=1)
    variance = (weights**2 * sigma**2).sum(axis=1) + _BEND**2
    return float((np.log1p(square / variance) + np.log(variance)).sum()) / _RUN
