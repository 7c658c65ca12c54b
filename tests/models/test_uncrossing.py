"""Balls that look alike keep the ways that lead straight from where they lay."""

from __future__ import annotations

import numpy as np
import pytest
from support.tracking_shots import R, overhead

from models.core.detections import Detections
from models.core.typing import FloatArray
from models.tracking.identity_switches import uncrossed
from models.tracking.table_detections import Sightings, sight
from models.tracking.tracklet_linking import Tracklet, make_tracklet

Pair = tuple[float, float]
Way = tuple[Pair, Pair, Pair]
"""Place at the burst (m), velocity before and after it (m/s)."""

T = np.arange(12) / 30
BURST = 6
"""Picture after which balls go other ways."""


def seen(ways: list[Way], colours: FloatArray) -> Sightings:
    """Balls on their ways, the burst half way between two pictures; row by row."""
    burst, scene = (T[BURST - 1] + T[BURST]) / 2, overhead()
    xy = np.array([
        [np.array(place) + np.array(before if t < burst else after) * (t - burst) for place, before, after in ways]
        for t in T
    ])  # fmt: skip
    count = len(T) * len(ways)
    one, colour = np.ones(count), np.tile(colours, (len(T), 1))
    noise = np.random.default_rng(1).normal(0, 0.5, (count, 2))
    px = scene.camera.to_pixels(xy.reshape(-1, 2), R) + noise
    frame = np.repeat(np.arange(len(T)), len(ways))
    coat = (colour, 0.1 * one, 0.1 * one, 0.6 * one)
    found = Detections(frame, px, 11.4 * one, 0 * px, *coat, one, 0.5 * one, 0.5 * one)
    return sight(found, np.arange(len(T)), scene)


def followed(sightings: Sightings, before: int, after: int, balls: int) -> Tracklet:
    """The track that follows one ball before the burst and another one after it."""
    row = np.array([k * balls + (before if k < BURST else after) for k in range(len(T))])
    return make_tracklet(np.arange(len(T)), row, sightings, T)


LYING = [((1.0, 0.6), (0.0, 0.0), (2.5, 1.0)), ((1.2, 0.75), (0.0, 0.0), (0.05, -0.1))]
"""One ball is hit away, past another one that hardly moves."""
ALIKE, OTHER = np.full((2, 3), 60.0), np.array([[60.0, 0.0, 0.0], [30.0, 40.0, 0.0]])


def test_exchanged_balls_are_put_right() -> None:
    sightings = seen(LYING, ALIKE)
    wrong = [followed(sightings, 0, 1, 2), followed(sightings, 1, 0, 2)]
    right = [followed(sightings, 0, 0, 2), followed(sightings, 1, 1, 2)]
    for found, true in zip(uncrossed(wrong, sightings, T, R), right, strict=True):
        np.testing.assert_array_equal(found.row, true.row)


def test_balls_that_were_followed_rightly_stay_as_they_are() -> None:
    sightings = seen(LYING, ALIKE)
    right = [followed(sightings, 0, 0, 2), followed(sightings, 1, 1, 2)]
    assert all(one is two for one, two in zip(uncrossed(right, sightings, T, R), right, strict=True))


def test_balls_of_different_colours_are_not_exchanged() -> None:
    sightings = seen(LYING, OTHER)
    wrong = [followed(sightings, 0, 1, 2), followed(sightings, 1, 0, 2)]
    mixed = [Tracklet(w.picture, w.row, OTHER[k], 1.0, w.start, w.end) for k, w in enumerate(wrong)]
    assert all(one is two for one, two in zip(uncrossed(mixed, sightings, T, R), mixed, strict=True))


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_a_head_on_contact_is_none_of_its_business(speed: float) -> None:
    # the first ball stops where the second one lay, less a diameter; the second goes on as the first came
    sightings = seen([((1.0 - 2 * R, 0.6), (speed, 0.0), (0.0, 0.0)), ((1.0, 0.6), (0.0, 0.0), (speed, 0.0))], ALIKE)
    right = [followed(sightings, 0, 0, 2), followed(sightings, 1, 1, 2)]
    assert all(one is two for one, two in zip(uncrossed(right, sightings, T, R), right, strict=True))


def test_a_ring_of_three_is_put_right() -> None:
    ways = [*LYING, ((1.1, 0.3), (0.0, 0.0), (-1.0, -1.0))]
    sightings = seen(ways, np.full((3, 3), 60.0))
    wrong = [followed(sightings, k, (k + 1) % 3, 3) for k in range(3)]
    for k, found in enumerate(uncrossed(wrong, sightings, T, R)):
        np.testing.assert_array_equal(found.row, followed(sightings, k, k, 3).row)
