"""Distractors on the cloth of training images are beneath the balls."""

from __future__ import annotations

import numpy as np
import pytest

from detectors.training.augmentation import PAINTERS, paint_distractors

SIDE = 96
BALLS = np.array([[30.0, 40.0, 7.0, 0, 0, 0, 1], [66.0, 60.0, 8.0, 20.0, -6.0, 2, 1], [np.nan] * 7], dtype=np.float32)


def cloth_image() -> np.ndarray:
    return np.random.default_rng(1).integers(90, 130, (SIDE, SIDE, 3)).astype(np.uint8)


def on_balls() -> np.ndarray:
    """Pixels (S, S) that a ball covers at some time of the exposure."""
    y, x = np.mgrid[:SIDE, :SIDE]
    at = np.stack([x, y], axis=-1)[:, :, None]
    times = np.linspace(-0.5, 0.5, 41)
    covered = np.zeros((SIDE, SIDE), dtype=bool)
    for bx, by, radius, dx, dy in BALLS[:2, :5].tolist():
        places = np.array([bx, by]) + times[:, None] * (dx, dy)
        covered |= (np.linalg.norm(at - places, axis=-1) < radius).any(axis=2)
    return covered


@pytest.mark.parametrize("seed", range(12))
def test_no_pixel_of_a_ball_is_changed_and_some_of_the_cloth_are(seed: int) -> None:
    before = cloth_image()
    after = paint_distractors(np.random.default_rng(seed), before, BALLS)
    assert after.dtype == np.uint8
    changed = (after != before).any(axis=2)
    assert not (changed & on_balls()).any()
    assert 0 < changed.mean() < 0.8


def test_the_same_draw_paints_the_same() -> None:
    one, other = (paint_distractors(np.random.default_rng(5), cloth_image(), BALLS) for _ in range(2))
    assert (one == other).all()


def test_an_image_without_balls_gets_distractors_too() -> None:
    none = np.full((3, 7), np.nan, dtype=np.float32)
    assert (paint_distractors(np.random.default_rng(2), cloth_image(), none) != cloth_image()).any()


@pytest.mark.parametrize("paint", PAINTERS)
def test_every_distractor_is_visible_where_it_is_painted(paint) -> None:  # type: ignore[no-untyped-def]
    """Each covers something within its reach, and nothing far from it."""
    cover = np.zeros((SIDE, SIDE), np.uint8)
    paint(np.random.default_rng(3), cover, np.array([48.0, 48.0]), 8.0, 0.6)
    y, x = np.nonzero(cover)
    assert len(x) > 5
    assert np.hypot(x - 48, y - 48).max() < 6 * 8.0
