"""Noise told a second time, by what a fit leaves: contacts look like noise to whoever does not know of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import Data, Solution, residuals
from models.tracking.track_noise import Noise

WINDOW = 25
"""Samples of a ball over which residuals are judged."""
_NORMAL_MEDIAN = 0.6745
"""Of the absolute value of a standard normal number."""
_FITTED = 0.85
"""Residuals over errors where a span of some fifteen samples has been fitted with five numbers and its contacts."""
_NOTABLE = 0.8
"""Errors that shrink by less change nothing that matters."""


def reappraised(tracks: Tracks, seen: Tracks, noise: Noise, solution: Solution, data: Data) -> Tracks | None:
    """`tracks` with smaller errors where the fit leaves less than they promise; None where it hardly does.

    No error becomes smaller than what `seen` states times the noise that is usual in the clip. `data` are the samples
    of `tracks` in the order of `models.estimation.joint_fit.fit_solution.gather`.
    """
    usual = float(np.median(noise.scale))
    miss = np.abs(np.einsum("kij,kj->ki", data.whiten, residuals(solution, data)))  # along, across
    sizes = np.stack([tracks.sigma_along, tracks.sigma], axis=-1)  # (T, N, 2)
    stated = np.stack([seen.sigma_along, seen.sigma], axis=-1)
    least = np.hypot(stated * usual, noise.floor)
    fresh = sizes.copy()
    for ball in np.unique(data.ball):
        rows = np.flatnonzero(tracks.observed[:, ball])
        told = _local(miss[data.ball == ball]) / (_NORMAL_MEDIAN * _FITTED)
        fresh[rows, ball] = np.clip(sizes[rows, ball] * told, np.minimum(least, sizes)[rows, ball], sizes[rows, ball])
    shrunk = (fresh < _NOTABLE * sizes)[tracks.observed]
    if not shrunk.any():
        return None
    return replace(tracks, sigma_along=fresh[..., 0], sigma=fresh[..., 1])


def _local(values: FloatArray) -> FloatArray:
    """Median (n, 2) of the values (n, 2) around each."""
    half = min(WINDOW, len(values)) // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect" if half < len(values) else "edge")
    medians: FloatArray = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)
    return medians
