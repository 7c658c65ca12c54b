"""Re-estimation of measurement noise from the fit residuals: contacts look like noise before they are fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.joint_solution import JointSolution, Observations
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import evaluate_residuals
from models.tracking.track_noise import TrackNoise

WINDOW_SAMPLES = 25
"""Samples of a ball over which the residuals are averaged."""
_NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""
_FITTED_SHARE = 0.85
"""Residuals over errors where a segment of about fifteen samples is fitted with five parameters and its contacts."""
_NOTABLE_SHRINKAGE = 0.8
"""Errors that shrink by less than this factor are left unchanged."""


def reestimate_noise(
    tracks: Tracks, original: Tracks, noise: TrackNoise, solution: JointSolution, observations: Observations
) -> Tracks | None:
    """Reduce the errors of `tracks` where the residuals are smaller; None if they hardly are.

    No error becomes smaller than that of `original` times the usual noise of the clip. `observations` are the samples
    of `tracks` in the order of `fit_solution.collect_observations`.
    """
    usual_scale = float(np.median(noise.scale))
    residual = np.abs(
        np.einsum("kij,kj->ki", observations.whiten, evaluate_residuals(solution, observations))
    )  # along, across
    sizes = np.stack([tracks.sigma_along, tracks.sigma], axis=-1)  # (T, N, 2)
    stated = np.stack([original.sigma_along, original.sigma], axis=-1)
    least = np.hypot(stated * usual_scale, noise.floor)
    reduced = sizes.copy()
    for ball in np.unique(observations.ball):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        ratio = _running_median(residual[observations.ball == ball]) / (_NORMAL_MEDIAN * _FITTED_SHARE)
        reduced[rows, ball] = np.clip(
            sizes[rows, ball] * ratio, np.minimum(least, sizes)[rows, ball], sizes[rows, ball]
        )
    shrunk = (reduced < _NOTABLE_SHRINKAGE * sizes)[tracks.is_observed]
    if not shrunk.any():
        return None
    return replace(tracks, sigma_along=reduced[..., 0], sigma=reduced[..., 1])


def _running_median(values: FloatArray) -> FloatArray:
    """Return the median (n, 2) of the values (n, 2) around each."""
    half = min(WINDOW_SAMPLES, len(values)) // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect" if half < len(values) else "edge")
    medians: FloatArray = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)
    return medians
