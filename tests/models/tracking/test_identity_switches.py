"""Balls that look alike keep the paths that lead straight from where they lay."""

from __future__ import annotations

import numpy as np
import pytest
from support.tracking_shots import R, overhead

from models.core.detections import Detections
from models.core.typing import FloatArray
from models.tracking.build_tracks import correct_identity_switches
from models.tracking.table_detections import TableDetections, project_detections
from models.tracking.tracklet_linking import Tracklet, make_tracklet

Pair = tuple[float, float]
Way = tuple[Pair, Pair, Pair]
"""Place at the switch (m), velocity before and after it (m/s)."""

T = np.arange(12) / 30
SWITCH_FRAME = 6
"""Frame after which balls go other ways."""


def make_detections(ways: list[Way], colours: FloatArray, error_px: float = 0.5) -> TableDetections:
    """Detections of balls on their paths, the contacts half way between two frames; row by row."""
    switch, scene = (T[SWITCH_FRAME - 1] + T[SWITCH_FRAME]) / 2, overhead()
    xy = np.array([
        [np.array(place) + np.array(before if t < switch else after) * (t - switch) for place, before, after in ways]
        for t in T
    ])  # fmt: skip
    count = len(T) * len(ways)
    one, colour = np.ones(count), np.tile(colours, (len(T), 1))
    noise = np.random.default_rng(1).normal(0, error_px, (count, 2))
    px = scene.camera.to_pixels(xy.reshape(-1, 2), R) + noise
    frame = np.repeat(np.arange(len(T)), len(ways))
    coat = (colour, 0.1 * one, 0.1 * one, 0.6 * one)
    image_detections = Detections(frame, px, 11.4 * one, 0 * px, *coat, one, 0.5 * one, 0.5 * one)
    return project_detections(image_detections, np.arange(len(T)), scene)


def join_paths(detections: TableDetections, before: int, after: int, balls: int) -> Tracklet:
    """The track that follows one ball before the contacts and another one after them."""
    row = np.array([k * balls + (before if k < SWITCH_FRAME else after) for k in range(len(T))])
    return make_tracklet(np.arange(len(T)), row, detections, T)


LYING = [((1.0, 0.6), (0.0, 0.0), (2.5, 1.0)), ((1.2, 0.75), (0.0, 0.0), (0.05, -0.1))]
"""One ball is hit away, past another one that hardly moves."""
ALIKE, OTHER = np.full((2, 3), 60.0), np.array([[60.0, 0.0, 0.0], [30.0, 40.0, 0.0]])


def test_switched_balls_are_corrected() -> None:
    detections = make_detections(LYING, ALIKE)
    wrong = [join_paths(detections, 0, 1, 2), join_paths(detections, 1, 0, 2)]
    right = [join_paths(detections, 0, 0, 2), join_paths(detections, 1, 1, 2)]
    for corrected, true in zip(correct_identity_switches(wrong, detections, T, R), right, strict=True):
        np.testing.assert_array_equal(corrected.row, true.row)


def test_correct_tracks_stay_as_they_are() -> None:
    detections = make_detections(LYING, ALIKE)
    right = [join_paths(detections, 0, 0, 2), join_paths(detections, 1, 1, 2)]
    assert all(one is two for one, two in zip(correct_identity_switches(right, detections, T, R), right, strict=True))


def test_balls_of_different_colours_are_not_swapped() -> None:
    detections = make_detections(LYING, OTHER)
    wrong = [join_paths(detections, 0, 1, 2), join_paths(detections, 1, 0, 2)]
    mixed = [Tracklet(w.frame_index, w.row, OTHER[k], 1.0, w.start, w.end) for k, w in enumerate(wrong)]
    assert all(one is two for one, two in zip(correct_identity_switches(mixed, detections, T, R), mixed, strict=True))


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_a_head_on_contact_is_no_switch(speed: float) -> None:
    # the first ball stops where the second one lay, less a diameter; the second goes on as the first came
    detections = make_detections(
        [((1.0 - 2 * R, 0.6), (speed, 0.0), (0.0, 0.0)), ((1.0, 0.6), (0.0, 0.0), (speed, 0.0))], ALIKE
    )
    right = [join_paths(detections, 0, 0, 2), join_paths(detections, 1, 1, 2)]
    assert all(one is two for one, two in zip(correct_identity_switches(right, detections, T, R), right, strict=True))


def test_a_ring_of_three_is_corrected() -> None:
    ways = [*LYING, ((1.1, 0.3), (0.0, 0.0), (-1.0, -1.0))]
    detections = make_detections(ways, np.full((3, 3), 60.0))
    wrong = [join_paths(detections, k, (k + 1) % 3, 3) for k in range(3)]
    for k, corrected in enumerate(correct_identity_switches(wrong, detections, T, R)):
        np.testing.assert_array_equal(corrected.row, join_paths(detections, k, k, 3).row)


@pytest.mark.parametrize(("radii", "is_switch"), [(0.85, False), (1.15, True)])
def test_a_kink_below_a_balls_radius_is_no_switch(radii: float, is_switch: bool) -> None:
    """Detections err by less, and two balls that roll side by side are farther apart."""
    side_by_side = [((1.0, 0.6 + k * radii * R), (1.0, 0.0), (1.0, 0.0)) for k in (0, 1)]
    detections = make_detections(side_by_side, ALIKE, error_px=0.0)
    kinked = [join_paths(detections, 0, 1, 2), join_paths(detections, 1, 0, 2)]
    corrected = correct_identity_switches(kinked, detections, T, R)
    assert any(one is not two for one, two in zip(corrected, kinked, strict=True)) == is_switch
