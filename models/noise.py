"""How noisy tracks are, told from the tracks alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.tracks import Tracks

Floats = NDArray[np.float64]

_MAD = 1.4826
"""Median absolute deviation to standard deviation, normal distribution."""


def third_differences(t: Floats, xy: Floats, sigma: Floats) -> Floats:
    """Of every four successive samples, what no parabola explains, in standard deviations (T-3, 2).

    Weights are divided differences, so times may be irregular. Shapes: t (T,), xy (T, 2), sigma (T,).
    """
    if len(t) < 4:
        return np.empty((0, 2))
    window = np.lib.stride_tricks.sliding_window_view(t, 4)  # (T-3, 4)
    gaps = window[:, :, None] - window[:, None, :]
    gaps[:, np.arange(4), np.arange(4)] = 1.0
    weight = 1 / gaps.prod(axis=2)
    spread = np.sqrt(((weight * np.lib.stride_tricks.sliding_window_view(sigma, 4)) ** 2).sum(axis=1))
    values = np.lib.stride_tricks.sliding_window_view(xy, 4, axis=0)  # (T-3, 2, 4)
    scaled: Floats = (values * weight[:, None, :]).sum(axis=2) / spread[:, None]
    return scaled


def noise_scale(tracks: Tracks, speed: float) -> float:
    """Noise over the sigmas of the tracks, from third differences of balls that move faster than `speed` (m/s).

    Moving balls count where there are enough of them: a compressed still picture repeats its errors, so that balls
    at rest look too good. NaN where there is nothing to tell it from.
    """
    moving, resting = [], []
    for ball in range(len(tracks.ids)):
        seen = tracks.observed[:, ball]
        t, xy = tracks.t[seen], tracks.xy[seen, ball]
        values = third_differences(t, xy, tracks.sigma[seen, ball])
        if not len(values):
            continue
        fast = np.linalg.norm(xy[3:] - xy[:-3], axis=1) > speed * (t[3:] - t[:-3])
        moving.append(values[fast])
        resting.append(values[~fast])
    for groups in (moving, resting):
        together = np.concatenate([np.abs(g).ravel() for g in groups]) if groups else np.empty(0)
        if len(together) >= 20:
            return float(_MAD * np.median(together))
    return float("nan")


def outliers(t: Floats, xy: Floats, sigma: Floats, limit: float = 8.0) -> NDArray[np.bool_]:
    """Samples (T,) that lie far off while the two before and the two after agree with each other without them.

    `limit` is in standard deviations of the sample and its neighbours.
    """
    bad = np.zeros(len(t), bool)
    if len(t) < 5:
        return bad
    left, right = xy[1:-3], xy[3:-1]
    share = ((t[2:-2] - t[1:-3]) / (t[3:-1] - t[1:-3]))[:, None]
    between = left + share * (right - left)
    jump = np.linalg.norm(xy[2:-2] - between, axis=1)
    step = np.linalg.norm(right - left, axis=1)
    before = np.linalg.norm(left - xy[:-4], axis=1) / (t[1:-3] - t[:-4])
    after = np.linalg.norm(xy[4:] - right, axis=1) / (t[4:] - t[3:-1])
    pace = step / (t[3:-1] - t[1:-3])
    steady = np.abs(pace - (before + after) / 2) < 0.2 * (before + after) / 2 + 2 * sigma[2:-2] / (t[3:-1] - t[1:-3])
    # a contact bends a path by at most what the ball can travel meanwhile
    bad[2:-2] = steady & (jump > limit * sigma[2:-2]) & (jump > 0.5 * step)
    return bad
