"""Frame windows, spots of motion and the outline of play."""

from __future__ import annotations

import numpy as np
import pytest

from detectors.flying.frame_windows import (
    WINDOW,
    FrameWindow,
    PlaneImage,
    align_window,
    choose_lags,
    find_shifts,
    neighbours_of,
    reduce_image,
)
from detectors.flying.motion_spots import find_spots, find_window_spots, map_lone_change
from detectors.flying.object_size import is_inside
from detectors.flying.spot_network import streak_from_double_angle
from detectors.flying.spot_patches import LUMA_LAYERS, PATCH_PX, cut_patches, cut_squares
from models.core.court_camera import CourtCamera
from models.core.scene import apply_homography
from models.core.typing import ByteArray

STILL = np.repeat(np.eye(3)[None], WINDOW, axis=0)


def colourless(luma: ByteArray) -> PlaneImage:
    return PlaneImage(luma, np.full((luma.shape[0] // 2, luma.shape[1] // 2, 2), 128, np.uint8))


def window_of(images: list[ByteArray]) -> FrameWindow:
    return align_window(0, [colourless(image) for image in images], STILL)


def test_neighbours_stay_in_their_view() -> None:
    assert neighbours_of(6, 0, 13, (2, 5)).tolist() == [1, 2, 4, 6, 8, 10, 11]
    for k in range(4, 12):
        rows = neighbours_of(k, 4, 12, (1, 4))
        assert rows[3] == k
        assert rows.min() >= 4
        assert rows.max() <= 11
        assert k not in rows[[0, 2, 4, 6]]
        assert rows[2] != rows[4]


@pytest.mark.parametrize(("fps", "lags"), [(25, (1, 4)), (30, (1, 5)), (50, (2, 8)), (60, (2, 10)), (120, (4, 20))])
def test_neighbours_are_a_thirtieth_and_a_sixth_of_a_second_away(fps: int, lags: tuple[int, int]) -> None:
    assert choose_lags(np.arange(20) / fps) == lags


def test_a_lone_dot_is_more_distinct_than_the_edge_of_a_moving_body() -> None:
    images = [np.full((120, 160), 60, np.uint8) for _ in range(WINDOW)]
    for k, image in enumerate(images, start=-1):
        image[30:90, 20 + 6 * k : 50 + 6 * k] = 200
        image[40 + 9 * k : 44 + 9 * k, 100:104] = 220
    change = map_lone_change(window_of(images))
    spots = find_spots(change)
    assert np.abs(spots.place[0] - [101, 59]).max() <= 2
    assert change[30, 2] == 0
    assert change[30, 25] == 0  # The body covers the place before or after.


def test_a_dot_that_hardly_moves_is_found_by_its_far_neighbours() -> None:
    images = [np.full((120, 160), 60, np.uint8) for _ in range(WINDOW)]
    for image, step, fall in zip(images, (-9, -1, 0, 0, 0, 1, 9), (14, 1, 0, 0, 0, 1, 14), strict=True):
        image[40 + fall : 45 + fall, 100 + step : 105 + step] = 220
    window = window_of(images)
    assert not map_lone_change(window)[:, :25].any()
    assert np.abs(find_window_spots(window, None)[0] - [102, 42]).max() <= 2


def test_a_ball_as_bright_as_the_court_is_found_by_its_colour() -> None:
    window = window_of([np.full((120, 160), 60, np.uint8) for _ in range(WINDOW)])
    assert len(find_window_spots(window, None)) == 0
    for image, x in zip(window.images, 20 + 8 * np.arange(WINDOW), strict=True):
        image.chroma[30:32, x // 2 : x // 2 + 2, 0] -= 12
    spots = find_window_spots(window, None)
    assert np.abs(spots[0] - [45, 61]).max() <= 2
    patches = cut_patches(window, spots[:1])[0]
    assert [layer.min() for layer in patches[LUMA_LAYERS:]] == [116, 128] * 3
    assert np.all(patches[:LUMA_LAYERS] == 60)


def test_a_caption_before_a_turning_camera_gives_no_spot() -> None:
    rng = np.random.default_rng(0)
    wide = np.clip(rng.normal(100, 2, (130, 240)), 0, 255).astype(np.uint8)
    steps = np.array([-16, -8, -4, 0, 4, 8, 16])
    shifts = STILL.copy()
    shifts[:, 0, 2] = steps
    images = [wide[10:110, 40 - step : 200 - step].copy() for step in steps]
    for image, step in zip(images, steps, strict=True):
        image[20:26, 30:34] = 240
        image[60:65, 80 + 2 * step : 85 + 2 * step] = 240
    spots = find_window_spots(align_window(0, [colourless(image) for image in images], shifts), None)
    assert np.abs(spots - [82, 62]).max(axis=1).min() <= 2
    assert np.abs(spots - [32, 23]).max(axis=1).min() > 8


def test_a_lens_moves_what_a_panning_camera_shows_by_less_at_the_corners() -> None:
    motion = np.repeat(np.eye(3)[None], WINDOW, axis=0)
    motion[:, 0, 2] = 20.0 * np.arange(WINDOW)
    parameters = np.array([-12.8, 3.05, 6.9, 1.44, -1.44, 1.04, 7.4, -0.03])
    camera = CourtCamera(parameters, np.eye(8), 1280, 720, is_left_handed=True, motion=motion)
    seen = np.array([[640.0, 360.0], [1000.0, 650.0]])
    moved = apply_homography(find_shifts(camera, np.arange(WINDOW), 1.0)[6], seen)
    flat, pan = camera.undistort(seen), np.array([60.0, 0.0])
    right = camera.distort(flat + pan)
    assert np.abs(moved - right).max() < 0.5
    assert np.abs(seen + pan - right).max() > 1.0


def test_noise_alone_is_less_distinct_than_any_object_of_three_px() -> None:
    rng = np.random.default_rng(0)
    images = [np.clip(rng.normal(100, 4, (240, 320)), 0, 255).astype(np.uint8) for _ in range(WINDOW)]
    assert find_spots(map_lone_change(window_of(images))).distinctness.max() < np.sqrt(3)


def test_a_neighbour_is_moved_onto_the_frame() -> None:
    rng = np.random.default_rng(0)
    wide = np.clip(rng.normal(100, 40, (130, 240)), 0, 255).astype(np.uint8)
    steps = np.array([-16, -8, -4, 0, 4, 8, 16])
    images = [wide[10:110, 40 - step : 200 - step].copy() for step in steps]
    shifts = STILL.copy()
    shifts[:, 0, 2] = steps
    window = align_window(0, [colourless(image) for image in images], shifts)
    for step in (1, 3):
        assert not map_lone_change(window, step)[:, 10:-10].any()
    patches = cut_patches(window, np.array([[80, 50]]))
    for layer in range(WINDOW):
        assert np.array_equal(patches[0, layer], patches[0, 3])
    assert patches[0, 3, PATCH_PX // 2, PATCH_PX // 2] == images[3][50, 80]


@pytest.mark.parametrize("scale", [0.93, 0.6, 0.5, 0.4, 0.3])
def test_a_reduced_image_shows_a_lone_px_wherever_it_is(scale: float) -> None:
    for x, y in np.ndindex(10, 10):
        luma = np.zeros((60, 80), np.uint8)
        luma[20 + y, 30 + x] = 255
        assert reduce_image(colourless(luma), scale).luma.max() > 4


def test_halves_of_an_image_of_odd_sides_stay_in_place() -> None:
    luma = np.zeros((101, 151), np.uint8)
    luma[90:94, 140:144] = 200
    patches = cut_patches(window_of([luma] * WINDOW), np.array([[142, 92]]))
    middle = PATCH_PX // 2
    half = patches[0, WINDOW:LUMA_LAYERS, middle - 2 : middle + 2, middle - 2 : middle + 2]
    assert (half == np.pad(np.full((2, 2), 200), ((1, 1), (1, 1)))).all()


def test_squares_continue_the_border_of_the_image() -> None:
    image = np.random.default_rng(0).integers(0, 256, (40, 60, 2), dtype=np.uint8)
    place = np.array([[30, 20], [0, 0], [59, 39], [-70, 20], [30, 200]])
    steps = np.arange(8) - 4
    for (x, y), square in zip(place, cut_squares(image, place, 8), strict=True):
        rows, columns = np.clip(y + steps, 0, 39), np.clip(x + steps, 0, 59)
        assert np.array_equal(square, np.moveaxis(image[rows][:, columns], 2, 0))


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
