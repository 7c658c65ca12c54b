"""Predictions within a clip: the state at a moment from the frames until then, and a check of its prediction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.errors import TrackError
from models.core.events import Events
from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import ShotPrediction, forecast_shot
from models.estimation.forecast.forecast_values import ForecastErrors
from models.estimation.forecast.solution_state import (
    MIN_NOISE_SPEED,
    build_state_estimate,
    collect_captured_observations,
    estimate_lack_of_fit,
)
from models.estimation.forecast.state_estimate import PARAMETERS_PER_BALL, StateEstimate
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.table_learning.learned_table import LearnedTable
from models.tracking.track_noise import apply_noise, estimate_noise

# Least number of frames that give speeds.
FEWEST_FRAMES = 5


# A function that explains the frames until a moment.
Explain = Callable[[Tracks, Scene], Shot]


def estimate_state(
    tracks: Tracks, scene: Scene, t: float, learned: LearnedTable | None = None, explain_past: Explain = explain
) -> StateEstimate:
    """Estimate the state of a shot at a moment; only frames until then are fitted.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        t: Presentation time, s.
        learned: What other shots taught about the table.
        explain_past: Explains the frames until then, or finds an explanation that was kept.

    Returns:
        States of the balls on the table, with their covariance.

    Raises:
        TrackError: If there are too few frames, or physics cannot be fitted.
    """
    observed_tracks = tracks.truncate_after(t)
    if len(observed_tracks.t) < FEWEST_FRAMES:
        raise TrackError(
            f"{len(observed_tracks.t)} frames were detected until {t:g} s; a prediction needs at least {FEWEST_FRAMES}"
        )
    shot = explain_past(observed_tracks, scene)
    fit, solution = view_shot(shot), shot.solution
    if solution is None:
        raise TrackError(f"physics could not be fitted to the frames until {t:g} s; {fit.trust.reasons[0]}")
    clock = fit.trajectory.clock
    now = t if clock is None else float(clock.capture_time_at(np.array(t)))
    inflation = estimate_lack_of_fit(solution, collect_captured_observations(observed_tracks, clock, scene.table))
    events = fit.events
    pocketed = {a for a, kind in zip(events.a, events.kind, strict=True) if kind == "pocket"}
    state = build_state_estimate(
        solution, observed_tracks.ids, now, scene.table, pocketed, fit.trust, inflation, learned
    )  # fmt: skip
    return _adopt_measured_motion(replace(state, t=t), fit, observed_tracks)


def _adopt_measured_motion(state: StateEstimate, fit: Fit, tracks: Tracks) -> StateEstimate:
    """Start balls whose last motion no fit explains where all outputs have them: rolling on the measured curve."""
    mean, covariance, moving = state.mean.copy(), state.covariance.copy(), state.moving.copy()
    state_at_t = fit.trajectory.at(state.t)
    for row, name in enumerate(state.ids):
        k = fit.trajectory.ids.index(name)
        if not (state_at_t.measured[k] and np.isfinite(state_at_t.xy[k]).all()):
            continue
        moving[row] = fit.moving[-1, tracks.ids.index(name)]
        here = slice(PARAMETERS_PER_BALL * row, PARAMETERS_PER_BALL * (row + 1))
        side = covariance[here, here][-1, -1] if moving[row] else 0.0
        spread = [state_at_t.sigma[k] ** 2] * 2 + [state_at_t.sigma_v[k] ** 2 if moving[row] else 0.0] * 2
        mean[here] = [*state_at_t.xy[k], *(state_at_t.v[k] if moving[row] else (0.0, 0.0)), 0.0, 0.0, 0.0]
        covariance[here], covariance[:, here] = 0.0, 0.0
        covariance[here, here] = np.diag([*spread, 0.0, 0.0, side])
    return replace(state, mean=mean, covariance=covariance, moving=moving)


# Share of the duration of a shot that a prediction of its rest is made from: most of the shot remains to compare.
OBSERVED_SHARE = 1 / 3


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


def compare_rest_of_shot(tracks: Tracks, scene: Scene, events: Events, learned: LearnedTable) -> ForecastErrors | None:
    """Predict the rest of a shot from its first part, and compare it with what was observed later.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        events: Events of the shot.
        learned: What other shots taught about the table.

    Returns:
        The errors; None if nothing moves, or the first part cannot be fitted.
    """
    if not len(events):
        return None
    first, last = float(events.t.min()), float(min(events.t.max(), tracks.t[-1]))
    t = first + OBSERVED_SHARE * (last - first)
    times = tracks.t[(tracks.t > t) & (tracks.t <= last)]
    try:
        prediction = forecast_shot(estimate_state(tracks, scene, t, learned), times)
    except (TrackError, ArithmeticError, ValueError):
        return None
    check = check_prediction(prediction, tracks)
    moved = prediction.state.moving[check.ball]
    ball, until = np.array(prediction.state.ids)[check.ball][moved], check.t[moved]
    is_later_cushion = (np.array(events.kind) == "cushion") & (events.t > t)
    is_before = (np.array(events.a) == ball[:, None]) & (events.t <= until[:, None])  # (K, E)
    cushions = (is_before & is_later_cushion).sum(axis=1)
    return ForecastErrors(t, tuple(ball.tolist()), until - t, cushions, check.error[moved])


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
