"""The struck ball is the first to leave its place."""

from __future__ import annotations

import numpy as np

from models.tracking.ball_classes import find_struck_ball

R = 0.0286
FRAMES = np.arange(30)


def resting(x: float) -> np.ndarray:
    jitter = np.random.default_rng(round(100 * x)).normal(0, 1e-3, (30, 2))
    return np.array([x, 0.5]) + jitter


def leaving(x: float, after: int) -> np.ndarray:
    return resting(x) + np.outer(np.clip(FRAMES - after, 0, None), [0.02, 0.01])


def test_the_first_ball_to_leave_is_struck() -> None:
    paths = [(FRAMES, xy) for xy in (resting(0.2), leaving(0.5, 12), leaving(1.0, 5))]
    assert find_struck_ball(paths, R) == 2


def test_two_that_leave_at_once_leave_it_open() -> None:
    assert find_struck_ball([(FRAMES, leaving(0.5, 8)), (FRAMES, leaving(1.0, 8))], R) is None


def test_no_ball_is_struck_where_all_rest_or_one_moves_from_the_start() -> None:
    assert find_struck_ball([(FRAMES, resting(0.2)), (FRAMES, resting(0.7))], R) is None
    assert find_struck_ball([(FRAMES, leaving(0.2, -5) + np.outer(FRAMES, [0.02, 0.0]))], R) is None


def test_a_ball_that_only_trembles_or_comes_back_did_not_leave() -> None:
    wobble = resting(0.2)
    wobble[10] += 3 * R
    assert find_struck_ball([(FRAMES, wobble), (FRAMES, leaving(0.8, 15))], R) == 1
