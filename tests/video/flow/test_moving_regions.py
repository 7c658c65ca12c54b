"""Everything except balls between two frames: moving objects are interpolated, resting ones are unchanged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from models.core.typing import ImageArray
from video.flow.moving_regions import find_moving_cells, find_moving_regions
from video.flow.optical_flow import prepare_flow

HEIGHT, WIDTH = 160, 240


def texture(seed: int, size: tuple[int, int]) -> NDArray[np.float64]:
    """Soft random blotches that optical flow can follow."""
    rng = np.random.default_rng(seed)
    blotches = rng.uniform(0, 255, (size[0] // 10 + 2, size[1] // 10 + 2, 3)).astype(np.float32)
    return np.asarray(cv2.resize(blotches, size[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def hand(left: int, noise: float = 0.0) -> ImageArray:
    """A textured object, 60 x 60 px, over a still background."""
    image = 0.4 * texture(1, (HEIGHT, WIDTH)) + 60
    image[50:110, left : left + 60] = texture(2, (60, 60))
    image += np.random.default_rng(left).normal(0, noise, image.shape)
    return np.asarray(np.clip(np.rint(image), 0, 255), dtype=np.uint8)


def square(a: ImageArray, b: ImageArray) -> float:
    return float(((a.astype(float) - b.astype(float)) ** 2).mean())


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_a_moving_object_is_interpolated_along_its_path(share: float) -> None:
    first, second, truth = hand(80), hand(96), hand(80 + round(16 * share))
    interpolated = prepare_flow(first, second).interpolate(share)
    blend = np.asarray(cv2.addWeighted(first, 1 - share, second, share, 0), dtype=np.uint8)
    assert square(interpolated, truth) < 0.15 * square(blend, truth)


def test_only_cells_with_motion_are_found() -> None:
    first, second = hand(80, 2.0), hand(96, 2.0)
    stirred = find_moving_cells(first, second)
    rows, columns = np.nonzero(stirred)
    assert rows.min() >= 50 // 4 - 1
    assert rows.max() <= 110 // 4 + 1
    assert columns.min() >= 80 // 4 - 1
    assert columns.max() <= 156 // 4 + 1
    assert not find_moving_cells(hand(80, 2.0), hand(80, 3.0)).any(), "noise is no motion"


def test_the_rest_of_the_frame_is_unchanged_and_there_is_no_seam() -> None:
    first, second = hand(80), hand(96)
    ground = first.copy()
    regions = find_moving_regions(first, second)
    assert regions
    for region in regions:
        region.blend_onto(ground, 0.5)
    x0, y0, x1, y1 = regions[0].box
    outside = np.ones((HEIGHT, WIDTH), dtype=bool)
    outside[y0:y1, x0:x1] = False
    assert outside.any()
    np.testing.assert_array_equal(ground[outside], first[outside])
    inner = [(x0, WIDTH, 1), (x1 - 1, WIDTH, 1)]
    for line, end, _ in inner:
        if 0 < line < end - 1:
            np.testing.assert_allclose(ground[y0:y1, line], first[y0:y1, line], atol=26)


@pytest.mark.parametrize("height", [340, 400])
def test_motion_along_two_sides_gets_two_boxes(height: int) -> None:
    rng = np.random.default_rng(6)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (480, 640, 3)).astype(np.uint8), (0, 0), 2)
    first = np.full((480, 640, 3), 90, dtype=np.uint8)
    second = first.copy()
    for image, shift in ((first, 0), (second, 6)):
        moved = np.roll(texture, (shift, shift), axis=(0, 1))
        image[:height, :60], image[410:450, 40:600] = moved[:height, :60], moved[410:450, 40:600]
    regions = find_moving_regions(first, second)
    assert len(regions) == 2
    interpolated = first.copy()
    for region in regions:
        region.blend_onto(interpolated, 1.0)
    moves = np.zeros((480, 640), dtype=bool)
    moves[:height, :60] = moves[410:450, 40:600] = True
    assert square(interpolated[moves], second[moves]) < 0.05 * square(first[moves], second[moves])
    assert sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in (region.box for region in regions)) < 0.4 * 480 * 640


def shift_image(image: ImageArray, x: float, y: float) -> ImageArray:
    """The image of a camera that has moved by (x, y) px."""
    shift = np.array([[1, 0, x], [0, 1, y]], dtype=float)
    return np.asarray(cv2.warpAffine(image, shift, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def test_edges_that_are_a_pixel_off_are_no_motion_where_the_camera_moves() -> None:
    sharp = np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8)
    sharp[:, 60:180] = 220
    assert find_moving_cells(sharp, shift_image(sharp, 1.5, 0.7)).any()
    assert not find_moving_cells(sharp, shift_image(sharp, 1.5, 0.7), camera_is_still=False).any()
    assert find_moving_cells(hand(80), hand(96), camera_is_still=False).any()


def test_a_region_is_blended_at_its_place_in_a_moving_camera() -> None:
    first, second = hand(80), hand(96)
    moved = np.array([[1, 0, 3.0], [0, 1, -2.0], [0, 0, 1]])
    ground, truth = shift_image(first, 3, -2), shift_image(hand(88), 3, -2)
    plain = square(ground, truth)
    for region in find_moving_regions(first, second, camera_is_still=False):
        region.blend_onto(ground, 0.5, moved)
    assert square(ground, truth) < 0.15 * plain


def test_a_region_outside_the_frame_changes_nothing() -> None:
    ground = hand(80)
    before = ground.copy()
    for region in find_moving_regions(hand(80), hand(96)):
        region.blend_onto(ground, 0.5, np.array([[1, 0, 2.0 * WIDTH], [0, 1, 0], [0, 0, 1]]))
    np.testing.assert_array_equal(ground, before)


def test_two_equal_frames_have_no_moving_region() -> None:
    assert find_moving_regions(hand(80), hand(80)) == ()
