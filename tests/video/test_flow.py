"""What is no ball, between two pictures: things that move are met half way, what rests is left alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from models.core.typing import ImageArray
from video.flow.moving_regions import find_stirred, open_regions
from video.flow.optical_flow import Blend, OfFunction, OpticalFlow

HEIGHT, WIDTH = 160, 240


def texture(seed: int, size: tuple[int, int]) -> NDArray[np.float64]:
    """Soft random blotches that a flow can hold on to."""
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0, 255, (size[0] // 10 + 2, size[1] // 10 + 2, 3)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def hand(left: int, noise: float = 0.0) -> ImageArray:
    """A textured thing, 60 x 60 px, over a still background."""
    picture = 0.4 * texture(1, (HEIGHT, WIDTH)) + 60
    picture[50:110, left : left + 60] = texture(2, (60, 60))
    picture += np.random.default_rng(left).normal(0, noise, picture.shape)
    return np.asarray(np.clip(np.rint(picture), 0, 255), dtype=np.uint8)


def square(a: ImageArray, b: ImageArray) -> float:
    return float(((a.astype(float) - b.astype(float)) ** 2).mean())


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_a_thing_that_moves_is_met_on_its_way(share: float) -> None:
    first, second, truth = hand(80), hand(96), hand(80 + round(16 * share))
    made = OpticalFlow().open(first, second)(share)
    blend = Blend().open(first, second)(share)
    assert square(made, truth) < 0.15 * square(blend, truth)


def test_flow_is_sought_only_where_something_moves() -> None:
    first, second = hand(80, 2.0), hand(96, 2.0)
    stirred = find_stirred(first, second)
    rows, columns = np.nonzero(stirred)
    assert rows.min() >= 50 // 4 - 1
    assert rows.max() <= 110 // 4 + 1
    assert columns.min() >= 80 // 4 - 1
    assert columns.max() <= 156 // 4 + 1
    assert not find_stirred(hand(80, 2.0), hand(80, 3.0)).any(), "noise is no motion"


def test_the_rest_of_the_picture_stays_bit_for_bit_and_there_is_no_seam() -> None:
    first, second = hand(80), hand(96)
    ground = first.copy()
    regions = open_regions(first, second, OpticalFlow())
    assert regions
    for region in regions:
        region.lay(ground, 0.5)
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
def test_what_moves_along_two_sides_is_no_box_around_all(height: int) -> None:
    rng = np.random.default_rng(6)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (480, 640, 3)).astype(np.uint8), (0, 0), 2)
    first = np.full((480, 640, 3), 90, dtype=np.uint8)
    second = first.copy()
    for picture, shift in ((first, 0), (second, 6)):
        moved = np.roll(texture, (shift, shift), axis=(0, 1))
        picture[:height, :60], picture[410:450, 40:600] = moved[:height, :60], moved[410:450, 40:600]
    regions = open_regions(first, second, Blend())
    assert len(regions) == 2
    made = first.copy()
    for region in regions:
        region.lay(made, 1.0)
    moves = np.zeros((480, 640), dtype=bool)
    moves[:height, :60] = moves[410:450, 40:600] = True
    assert square(made[moves], second[moves]) < 0.05 * square(first[moves], second[moves])
    assert sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in (region.box for region in regions)) < 0.4 * 480 * 640


def drifted(picture: ImageArray, x: float, y: float) -> ImageArray:
    """What a camera sees that has moved by (x, y) px."""
    shift = np.array([[1, 0, x], [0, 1, y]], dtype=float)
    return np.asarray(cv2.warpAffine(picture, shift, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def test_edges_that_are_a_pixel_off_do_not_move_where_the_camera_does() -> None:
    sharp = np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8)
    sharp[:, 60:180] = 220
    assert find_stirred(sharp, drifted(sharp, 1.5, 0.7)).any()
    assert not find_stirred(sharp, drifted(sharp, 1.5, 0.7), steady=False).any()
    assert find_stirred(hand(80), hand(96), steady=False).any()


def test_a_region_is_laid_where_a_moving_camera_has_it() -> None:
    first, second = hand(80), hand(96)
    moved = np.array([[1, 0, 3.0], [0, 1, -2.0], [0, 0, 1]])
    ground, truth = drifted(first, 3, -2), drifted(hand(88), 3, -2)
    plain = square(ground, truth)
    for region in open_regions(first, second, OpticalFlow(), steady=False):
        region.lay(ground, 0.5, moved)
    assert square(ground, truth) < 0.15 * plain


def test_a_region_outside_the_picture_is_not_laid() -> None:
    ground = hand(80)
    before = ground.copy()
    for region in open_regions(hand(80), hand(96), OpticalFlow()):
        region.lay(ground, 0.5, np.array([[1, 0, 2.0 * WIDTH], [0, 1, 0], [0, 0, 1]]))
    np.testing.assert_array_equal(ground, before)


def test_any_function_of_two_pictures_and_a_share_can_stand_in() -> None:
    asked: list[float] = []

    def darker(first: ImageArray, second: ImageArray, share: float) -> ImageArray:
        asked.append(share)
        return np.minimum(first, second)

    first, second = hand(80), hand(96)
    (region,) = open_regions(first, second, OfFunction(darker))
    ground = np.full_like(first, 255)
    region.lay(ground, 0.25)
    assert asked == [0.25]
    middle = np.s_[70:90, 100:130]
    np.testing.assert_array_equal(ground[middle], np.minimum(first, second)[middle])


def test_two_still_pictures_have_nothing_to_hand_over() -> None:
    assert open_regions(hand(80), hand(80), OpticalFlow()) == ()
