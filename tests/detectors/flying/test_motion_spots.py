"""Frame windows, spots of motion and the outline of play."""

from __future__ import annotations

import numpy as np
import pytest

from detectors.flying.frame_windows import FrameWindow, align_window, choose_lag, neighbours_of
from detectors.flying.motion_spots import find_spots, map_lone_change
from detectors.flying.object_size import is_inside
from detectors.flying.spot_network import streak_from_double_angle
from detectors.flying.spot_patches import MIDDLE, cut_patches
from models.core.typing import ByteArray

STILL = np.repeat(np.eye(3)[None], 5, axis=0)


def window_of(images: list[ByteArray]) -> FrameWindow:
    return align_window(0, images, STILL)


def test_neighbours_stay_in_their_view() -> None:
    assert neighbours_of(5, 0, 11, 2).tolist() == [1, 3, 5, 7, 9]
    for k in range(4, 9):
        rows = neighbours_of(k, 4, 9, 1)
        assert rows[2] == k
        assert rows.min() >= 4
        assert rows.max() <= 8
        assert k not in rows[[1, 3]]
        assert rows[1] != rows[3]


@pytest.mark.parametrize(("fps", "lag"), [(25, 1), (30, 1), (50, 2), (60, 2), (120, 4)])
def test_neighbours_are_about_a_thirtieth_of_a_second_apart(fps: int, lag: int) -> None:
    assert choose_lag(np.arange(20) / fps) == lag


def test_a_lone_dot_is_more_distinct_than_the_edge_of_a_moving_body() -> None:
    images = [np.full((120, 160), 60, np.uint8) for _ in range(5)]
    for k, image in enumerate(images):
        image[30:90, 20 + 6 * k : 50 + 6 * k] = 200
        image[40 + 9 * k : 44 + 9 * k, 100:104] = 220
    change = map_lone_change(window_of(images))
    spots = find_spots(change)
    assert np.abs(spots.place[0] - [101, 59]).max() <= 2
    assert change[60, 5] == 0
    assert change[60, 50] == 0  # The body covers the place before or after.


def test_noise_alone_is_less_distinct_than_any_object_of_three_px() -> None:
    rng = np.random.default_rng(0)
    images = [np.clip(rng.normal(100, 4, (240, 320)), 0, 255).astype(np.uint8) for _ in range(5)]
    assert find_spots(map_lone_change(window_of(images))).distinctness.max() < np.sqrt(3)


def test_a_neighbour_is_moved_onto_the_frame() -> None:
    rng = np.random.default_rng(0)
    wide = np.clip(rng.normal(100, 40, (130, 240)), 0, 255).astype(np.uint8)
    images = [wide[10:110, 20 - 4 * k : 180 - 4 * k].copy() for k in range(-2, 3)]
    shifts = STILL.copy()
    shifts[:, 0, 2] = [-8, -4, 0, 4, 8]
    window = align_window(0, images, shifts)
    assert not map_lone_change(window)[:, 8:-8].any()
    patches = cut_patches(window, np.array([[80, 50]]))
    assert np.array_equal(patches[0, 0], patches[0, 2])
    assert np.array_equal(patches[0, 4], patches[0, 2])
    assert patches[0, 2, MIDDLE, MIDDLE] == images[2][50, 80]


def test_places_outside_a_polygon_are_told_in_both_directions_of_rotation() -> None:
    square = np.array([[0, 0], [10, 0], [10, 10], [0, 10.0]])
    places = np.array([[5, 5], [11, 5], [-1, -1], [9.9, 0.1]])
    for outline in (square, square[::-1]):
        assert is_inside(outline, places).tolist() == [True, False, False, True]
    assert is_inside(None, places).all()


def test_a_doubled_angle_has_no_sign() -> None:
    angle = np.radians([10.0, 80.0, 100.0, 170.0])
    streak = 7 * np.column_stack([np.cos(angle), np.sin(angle)])
    doubled = 7 * np.column_stack([np.cos(2 * angle), np.sin(2 * angle)])
    back = streak_from_double_angle(doubled)
    assert np.abs(np.abs((back * streak).sum(axis=1)) - 49).max() < 1e-9
