"""Overlapping balls are moved apart or removed."""

from __future__ import annotations

import numpy as np
import pytest
from support.rendered_balls import PX_PER_M, RADIUS, build_test_scene

from detectors.measurement.frame_detections import FrameDetections
from detectors.measurement.overlap_resolution import resolve_overlaps

SIZE_PX = RADIUS * PX_PER_M
MIDDLE = np.array([300.0, 170.0])


def detections_at(centre: np.ndarray, sigma: np.ndarray | float, score: np.ndarray | float = 0.9) -> FrameDetections:
    n = len(centre)
    sigma = np.broadcast_to(np.asarray(sigma, float), n).copy()
    scores = np.broadcast_to(np.asarray(score, float), n).copy()
    return FrameDetections(
        np.asarray(centre, float), np.full(n, SIZE_PX), np.zeros((n, 2)), scores, sigma, sigma.copy()
    )


def rack(rows: int = 5) -> np.ndarray:
    """Px of balls that touch in a triangle."""
    step = 2 * SIZE_PX
    return MIDDLE + np.array(
        [[r * step * np.sqrt(0.75), (i - r / 2) * step] for r in range(rows) for i in range(r + 1)]
    )


def closest(centre: np.ndarray) -> float:
    apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min())


def test_of_two_that_overlap_the_one_that_is_less_sure_gives_way() -> None:
    pair = MIDDLE + np.array([[0.0, 0.0], [1.7 * SIZE_PX, 0.0]])
    after = resolve_overlaps(
        detections_at(pair, np.array([0.3, 0.9]), np.array([0.9, 0.8])), build_test_scene(), 0
    ).centre
    shift = after - pair
    assert closest(after) == pytest.approx(2 * SIZE_PX, rel=0.03)
    assert shift[0, 0] < 0 < shift[1, 0]
    assert shift[1, 0] / -shift[0, 0] == pytest.approx(0.9**2 / 0.3**2, rel=0.02)
    assert np.abs(shift[:, 1]).max() < 1e-6


def test_balls_that_have_room_stay_to_the_last_bit() -> None:
    lone = detections_at(MIDDLE + np.array([[0.0, 0.0], [2.05 * SIZE_PX, 0.0], [0.0, 60.0]]), 0.5)
    after = resolve_overlaps(lone, build_test_scene(), 0)
    assert (after.centre == lone.centre).all()


def test_a_ball_detected_twice_is_one() -> None:
    """No stated error explains the overlap: the one with the higher score is kept in place."""
    pair = detections_at(MIDDLE + np.array([[0.0, 0.0], [1.2 * SIZE_PX, 0.0]]), 0.2, np.array([0.8, 0.95]))
    after = resolve_overlaps(pair, build_test_scene(), 0)
    assert after.centre.tolist() == [pair.centre[1].tolist()]


def test_errors_that_are_stated_keep_both() -> None:
    pair = detections_at(MIDDLE + np.array([[0.0, 0.0], [1.2 * SIZE_PX, 0.0]]), 1.5)
    after = resolve_overlaps(pair, build_test_scene(), 0)
    assert len(after.centre) == 2
    assert closest(after.centre) > 1.9 * SIZE_PX


def test_a_streak_moves_along_its_way_first() -> None:
    """Its middle is uncertain along it: that is where it gives way."""
    pair = detections_at(MIDDLE + np.array([[0.0, 0.0], [1.6 * SIZE_PX, 0.3 * SIZE_PX]]), 0.3)
    pair.streak[1] = (3 * SIZE_PX, 0.0)
    pair.sigma_along[1] = 2.0
    after = resolve_overlaps(pair, build_test_scene(), 0)
    moving = int(np.argmax(np.abs(after.streak[:, 0])))  # what moves comes first
    shift, other = after.centre[moving] - pair.centre[1], after.centre[1 - moving] - pair.centre[0]
    assert shift[0] > 5 * abs(shift[1])
    assert np.linalg.norm(other) < 0.1 * np.linalg.norm(shift)


@pytest.mark.parametrize("seed", range(4))
def test_a_rack_is_placed_better_together_than_ball_by_ball(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, sigma = rack(), 0.15 * SIZE_PX
    measured = truth + rng.normal(0, sigma, truth.shape)
    after = resolve_overlaps(detections_at(measured, sigma), build_test_scene(), 0).centre
    assert len(after) == len(truth)
    assert closest(after) > 1.9 * SIZE_PX
    before, now = (np.sqrt(((places - truth) ** 2).mean()) for places in (measured, after))
    assert now < 0.95 * before
