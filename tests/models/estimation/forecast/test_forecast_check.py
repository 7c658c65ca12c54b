"""The state at a moment of a clip, and how the rest of the shot is compared with its prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.events import Events
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.estimation.forecast.forecast_check import (
    OBSERVED_SHARE,
    _adopt_measured_motion,
    compare_rest_of_shot,
    estimate_state,
)
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.table_learning.learned_table import DEFAULT_SCATTER, LearnedTable
from models.physics.billiards.parameter_vector import ROLLING_MU, SLIDING_MU, neutral_parameters

R = 0.028575
TABLE = Table("pool-9ft", "pool", 2.54, 1.27, R, 0.17, False)
SHOWN = np.arange(0, 3, 1 / 60)


def events_at(*rows: tuple[str, float, float]) -> Events:
    """Kinds, times and probabilities of the events of one ball."""
    kinds, t, probability = (list(column) for column in zip(*rows, strict=True))
    one = np.ones(len(t))
    return Events(
        tuple(kinds), np.array(t), 1e-3 * one, 60 * np.array(t), ("cue",) * len(t),
        tuple("" if kind in ("strike", "rest") else "red" for kind in kinds), np.zeros((len(t), 2)),
        np.array(probability), one, one, one,
    )  # fmt: skip


def rolling() -> tuple[Tracks, Scene]:
    """A ball that rolls from 0.5 s on, at 1 m/s and slower by mu g; 60 fps, 0.3 mm of noise."""
    t = SHOWN[SHOWN < 1.6]
    xy = np.stack([0.3 + rolling_distance(t - 0.5), np.full_like(t, 0.6)], axis=-1)[:, None]
    xy = xy + np.random.default_rng(4).normal(0, 3e-4, xy.shape)
    sigma = np.full((len(t), 1), 3e-4)
    tracks = Tracks(
        np.arange(len(t)), t, ("cue",), ("cue",), xy, 350 * xy + 30, sigma, sigma, np.zeros_like(xy),
        np.full((len(t), 1), 10.0), np.zeros((1, 3)),
    )  # fmt: skip
    matrix = np.array([[350.0, 0, 0, 30], [0, 350.0, 0, 30], [0, 0, 0, 1]])
    camera = Camera(matrix, 950, 505, 350 * TABLE.corners + 30, np.eye(8), "noses", 3.0, 0.5)
    return tracks, Scene(TABLE, camera, np.zeros(3), ())


def rolling_distance(t: np.ndarray) -> np.ndarray:
    """m that it goes in t (s)."""
    return np.asarray(np.where(t < 0, 0.0, t - 0.5 * 0.01 * 9.81 * t**2))


def make_learned_table() -> LearnedTable:
    """Make the table that the ball rolls on."""
    physics = neutral_parameters()
    physics[[SLIDING_MU, ROLLING_MU]] = 0.2, 0.01
    return LearnedTable("mirror", physics, DEFAULT_SCATTER, np.zeros(4), 1e-6 * np.eye(4))


@pytest.mark.parametrize("error", [ArithmeticError("too many contacts"), np.linalg.LinAlgError("singular")])
def test_a_state_that_cannot_be_simulated_is_not_compared_and_stops_no_run(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr("models.estimation.forecast.forecast_check.forecast_shot", refuse)
    events = events_at(("strike", 0.5, 1.0), ("rest", 1.55, 1.0))
    assert compare_rest_of_shot(*rolling(), events, make_learned_table()) is None


def test_a_ball_that_appears_just_then_causes_no_error() -> None:
    tracks, scene = rolling()
    glimpsed = np.full_like(tracks.xy, np.nan)
    glimpsed[(tracks.t > 0.66) & (tracks.t < 0.7)] = [2.0, 0.3]
    both = np.concatenate([tracks.xy, glimpsed], axis=1)
    there = np.where(np.isfinite(both[..., 0]), 3e-4, np.nan)
    more = Tracks(
        tracks.frame, tracks.t, ("cue", "red"), ("cue", "red"), both, 350 * both + 30, there, there,
        np.where(np.isfinite(both), 0.0, np.nan), np.where(np.isfinite(there), 10.0, np.nan), np.zeros((2, 3)),
    )  # fmt: skip
    assert "cue" in estimate_state(more, scene, 0.7).ids


def test_the_rest_of_a_shot_is_compared_with_a_prediction_from_its_first_part() -> None:
    tracks, scene = rolling()
    learned = make_learned_table()
    events = events_at(("strike", 0.5, 1.0), ("cushion", 1.3, 1.0), ("rest", 1.55, 1.0))
    errors = compare_rest_of_shot(tracks, scene, events, learned)
    assert errors is not None
    assert errors.t == pytest.approx(0.5 + OBSERVED_SHARE * 1.05)
    assert set(errors.ball) == {"cue"}
    assert errors.error.max() < 0.02
    np.testing.assert_array_equal(errors.cushions, (errors.t + errors.seconds >= 1.3).astype(int))
    later = tracks.t > errors.t
    moved = replace(tracks, xy=np.where(later[:, None, None], tracks.xy + np.array([0.0, 0.1]), tracks.xy))
    far = compare_rest_of_shot(moved, scene, events, learned)
    assert far is not None
    assert far.error.min() > 0.08, "the prediction uses no later frame"


@pytest.mark.parametrize("moves", [True, False])
def test_a_ball_whose_motion_no_fit_explains_starts_where_all_outputs_have_it(moves: bool) -> None:
    tracks, scene = rolling()
    shot = explain(tracks, scene)
    fit, t = view_shot(shot), float(tracks.t[-1])
    state = estimate_state(tracks, scene, t, explain_past=lambda *_: shot)
    position = fit.trajectory.position.copy()
    position[:, 0] += [0.05, -0.02]
    phase = ("measured",) * len(position)
    fit = replace(fit, trajectory=replace(fit.trajectory, position=position, phase=phase))
    fit = replace(fit, moving=np.full_like(fit.moving, moves))
    adopted = _adopt_measured_motion(state, fit, tracks)
    seen = fit.trajectory.at(t)
    np.testing.assert_allclose(adopted.mean[:2], seen.xy[0])
    np.testing.assert_allclose(adopted.mean[2:4], seen.v[0] if moves else 0.0)
    assert adopted.moving[0] == moves
    np.testing.assert_allclose(np.sqrt(np.diag(adopted.covariance)[:2]), seen.sigma[0])
