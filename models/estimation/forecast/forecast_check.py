"""A prediction held against what was seen afterwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.current_state import NOISY_FROM
from models.estimation.forecast.ensemble_prediction import Prediction
from models.tracking.track_noise import estimate_noise, with_noise


@dataclass(frozen=True, slots=True)
class Hindsight:
    """K places that were seen of balls that were predicted, by ball, then by time."""

    ball: NDArray[np.int64]
    """(K,) index into the balls of the prediction."""
    t: FloatArray
    """(K,) s."""
    error: FloatArray
    """(K,) m from the predicted path."""
    sigma: FloatArray
    """(K,) m per axis, as predicted."""
    level: FloatArray
    """(K,) share of the probability nearer to the middle, the noise of the sighting allowed for; NaN where the ball
    should be in a pocket."""


def hindsight(prediction: Prediction, seen: Tracks) -> Hindsight:
    """Every place seen at one of the moments that were predicted, after the first.

    How noisy it was seen is told from all of `seen`: that is of the sighting, not of the prediction.
    """
    measured = with_noise(seen, estimate_noise(seen, NOISY_FROM, prediction.outlook.table.ball_radius))
    errors = np.linalg.inv(np.where(seen.observed[..., None, None], measured.whitening, np.eye(2)))
    found = []
    for ball, name in enumerate(prediction.outlook.ids):
        column = seen.ids.index(name)
        for row in np.flatnonzero(prediction.t > prediction.outlook.t + 1e-9):
            picture = np.flatnonzero((np.abs(seen.t - prediction.t[row]) < 1e-9) & seen.observed[:, column])
            if len(picture):
                xy, error = seen.xy[picture[0], column], errors[picture[0], column]
                level = prediction.level(int(row), ball, xy, error @ error.T)
                miss = float(np.hypot(*(xy - prediction.path[row, ball])))
                found.append((ball, prediction.t[row], miss, prediction.sigma[row, ball], level))
    columns = np.array(found, dtype=np.float64).reshape(-1, 5)
    return Hindsight(columns[:, 0].astype(np.int64), *columns[:, 1:].T)
