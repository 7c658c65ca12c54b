"""Comparison of a prediction with the positions measured afterwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.current_state import MIN_NOISE_SPEED
from models.estimation.forecast.ensemble_prediction import ShotPrediction
from models.tracking.track_noise import apply_noise, estimate_noise


@dataclass(frozen=True, slots=True)
class PredictionCheck:
    """K measured places of predicted balls, by ball, then by time."""

    ball: NDArray[np.int64]
    """(K,) index among the balls of the prediction."""
    t: FloatArray
    """(K,) s."""
    error: FloatArray
    """(K,) m from the predicted path."""
    sigma: FloatArray
    """(K,) m per axis, as predicted."""
    level: FloatArray
    """(K,) share of the probability that is denser, including the measurement noise; NaN where the ball should be in a
    pocket.
    """


def check_prediction(prediction: ShotPrediction, tracks: Tracks) -> PredictionCheck:
    """Compare a prediction with every place measured at one of its moments, after the first.

    The measurement noise is estimated from all of `tracks`, since it belongs to the measurement, not to the prediction.

    Args:
        prediction: Prediction of N balls.
        tracks: Tracks of the whole shot.

    Returns:
        Errors and levels of K places.
    """
    measured = apply_noise(tracks, estimate_noise(tracks, MIN_NOISE_SPEED, prediction.state.table.ball_radius))
    errors = np.linalg.inv(np.where(tracks.is_observed[..., None, None], measured.whitening, np.eye(2)))
    rows = []
    for ball, name in enumerate(prediction.state.ids):
        column = tracks.ids.index(name)
        for row in np.flatnonzero(prediction.t > prediction.state.t + 1e-9):
            frames = np.flatnonzero((np.abs(tracks.t - prediction.t[row]) < 1e-9) & tracks.is_observed[:, column])
            if len(frames):
                xy, error = tracks.xy[frames[0], column], errors[frames[0], column]
                level = prediction.level(int(row), ball, xy, error @ error.T)
                distance = float(np.hypot(*(xy - prediction.path[row, ball])))
                rows.append((ball, prediction.t[row], distance, prediction.sigma[row, ball], level))
    columns = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return PredictionCheck(columns[:, 0].astype(np.int64), *columns[:, 1:].T)
