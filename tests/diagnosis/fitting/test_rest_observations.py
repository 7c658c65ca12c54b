"""Observations of balls at rest in recordings that leave out what does not move."""

from __future__ import annotations

import numpy as np

from diagnosis.fitting.diagnosis_windows import _find_split_rows, _split_at_rest, add_rest_observations
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE

T = np.arange(100) / 50


def record(others: dict[str, dict[int, tuple[float, float]]]) -> Recording:
    """Record a ball that always moves, and others at the rows that are given."""
    positions = np.full((len(T), 1 + len(others), 2), np.nan)
    positions[:, 0] = np.stack([T, 0.5 * T], axis=1)
    for k, samples in enumerate(others.values(), start=1):
        for row, place in samples.items():
            positions[row, k] = place
    return Recording(
        0, np.arange(len(T)), T, ("cue", *others), positions, np.full(positions.shape[:2], 1e-3), TABLE_PLANE
    )


def test_a_ball_at_rest_is_in_every_window() -> None:
    segment = record({"red": {0: (1.0, 1.0), 99: (1.0, 1.001)}})
    parts = _split_at_rest((segment,), 0.5)
    assert [len(part.t) for part in parts] == [25] * 4
    np.testing.assert_allclose([part.positions[0, 1] for part in parts], [(1.0, 1.0)] * 4)
    assert all(part.is_observed[:, 1].sum() >= 2 for part in parts)


def test_added_samples_hold_the_information_of_one() -> None:
    segment = record({"red": {0: (1.0, 1.0), 99: (1.0, 1.0)}})
    filled = add_rest_observations(segment, _find_split_rows(segment, 0.5))
    added = filled.is_observed & ~segment.is_observed
    np.testing.assert_allclose((filled.sigma[added] ** -2).sum(), 1e-3**-2)
    np.testing.assert_array_equal(filled.sigma[~added], segment.sigma[~added])


def test_a_ball_that_rolls_out_rests_where_it_is_seen_last() -> None:
    segment = record({"red": {0: (1.0, 1.0), 10: (1.2, 1.0), 20: (1.3, 1.0), 99: (1.31, 1.0)}})
    filled = add_rest_observations(segment, np.array([0, 50, 100]))
    np.testing.assert_allclose(filled.positions[50, 1], (1.31, 1.0))


def test_a_ball_that_was_lost_while_it_moved_gets_no_place() -> None:
    segment = record({"red": {0: (1.0, 1.0), 5: (1.05, 1.0), 99: (2.0, 1.0)}})
    filled = add_rest_observations(segment, np.array([0, 50, 100]))
    np.testing.assert_array_equal(filled.is_observed, segment.is_observed)


def test_a_pocketed_ball_does_not_keep_a_shot_in_one_window() -> None:
    segment = record({"red": {row: (1.0 + 0.02 * row, 1.0) for row in range(30)}})
    assert [len(part.t) for part in _split_at_rest((segment,), 0.5)] == [25] * 4


def test_a_rarely_observed_ball_lengthens_its_window_alone() -> None:
    segment = record({"red": {row: (1.0 + 0.01 * row, 1.0) for row in (*range(25), 40, 60, *range(75, 100))}})
    assert [len(part.t) for part in _split_at_rest((segment,), 0.5)] == [25, 50, 25]
