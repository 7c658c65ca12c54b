"""Trajectories evaluate their pieces, and are undefined outside them."""

from __future__ import annotations

import numpy as np
from support.filmed_shots import random_shot

from models.core.trajectory import Trajectory
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot


def one_parabola() -> Trajectory:
    """Ball `a`: x = 1 + 2 tau - tau^2, y = 3, from 1 s to 2 s."""
    position = np.array([[[1.0, 3.0], [2.0, 0.0], [-1.0, 0.0], [0.0, 0.0]]])
    spin = np.full((1, 2, 3), np.nan)
    covariance = np.diag([1e-6, 1e-6, 1e-4, 1e-4])[None]
    ends = np.array([1.0]), np.array([2.0])
    return Trajectory(("a", "b"), np.array([0]), *ends, position, spin, ("roll",), covariance)


def test_a_piece_is_its_polynomial() -> None:
    state = one_parabola().at(np.array([1.0, 1.5, 2.0]))
    np.testing.assert_allclose(state.xy[:, 0], [[1, 3], [1.75, 3], [2, 3]])
    np.testing.assert_allclose(state.v[:, 0], [[2, 0], [1, 0], [0, 0]])
    assert not state.measured.any()


def test_uncertainty_grows_with_the_velocity_error() -> None:
    state = one_parabola().at(np.array([1.0, 2.0]))
    np.testing.assert_allclose(state.sigma[:, 0], np.sqrt([1e-6, 1e-6 + 1e-4]))


def test_a_ball_is_undefined_outside_its_pieces() -> None:
    state = one_parabola().at(np.array([0.9, 1.5, 2.1]))
    assert np.isnan(state.xy[[0, 2], 0]).all()
    assert np.isnan(state.xy[:, 1]).all()


def test_states_have_the_shape_of_the_times() -> None:
    assert one_parabola().at(1.5).xy.shape == (2, 2)
    assert one_parabola().at(np.ones((3, 4))).w.shape == (3, 4, 2, 3)


def test_pieces_of_a_fit_do_not_overlap_and_join_without_jumps() -> None:
    shot = random_shot(6)
    path = view_shot(explain(shot.tracks, shot.scene)).trajectory
    for ball in range(3):
        rows = np.flatnonzero(path.ball == ball)
        assert np.all(path.start[rows[1:]] >= path.end[rows[:-1]] - 1e-9)
        length = (path.end - path.start)[rows]
        last = np.einsum("mk,mkd->md", length[:, None] ** np.arange(4), path.position[rows])
        assert np.all(np.linalg.norm(last[:-1] - path.position[rows[1:], 0], axis=1) < 2e-3)


def test_energy_never_grows_within_a_piece() -> None:
    shot = random_shot(3)
    path = view_shot(explain(shot.tracks, shot.scene)).trajectory
    for row in range(len(path.ball)):
        if path.phase[row] != "roll":
            continue
        t = np.linspace(path.start[row], path.end[row], 7)[1:-1]
        assert np.all(np.diff(np.linalg.norm(path.at(t).v[:, path.ball[row]], axis=1)) < 1e-6)
