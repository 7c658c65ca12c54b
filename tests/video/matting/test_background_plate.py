from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import ImageArray
from video.matting.background_plate import (
    COVERED_BY_BALL,
    COVERED_BY_SHADOW,
    BackgroundPlate,
    estimate_background_plate,
)

SIZE, BALL, RADIUS = 96, (40, 48), 8
REGION = np.zeros((SIZE, SIZE), dtype=bool)
REGION[22:74, 10:86] = True


def cloth(marked: bool = False) -> ImageArray:
    """A green gradient; marked: with a white line across."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    ground = np.stack([20 + x / 12, 110 + y / 6, 70 + x / 12], axis=-1).astype(np.uint8)
    if marked:
        ground[46:50] = 230
    return ground


def frame_with_ball(ground: ImageArray, rng: np.random.Generator) -> tuple[ImageArray, ImageArray, None]:
    """The ball rests; its coverage mask and shadow."""
    image, covered = add_noise(ground, rng), np.zeros((SIZE, SIZE), dtype=np.uint8)
    cv2.circle(image, BALL, RADIUS, (240, 240, 220), -1)
    cv2.circle(covered, BALL, 2 * RADIUS, COVERED_BY_SHADOW, -1)
    cv2.circle(covered, BALL, RADIUS + 2, COVERED_BY_BALL, -1)
    return image, covered, None


def frame_without_ball(
    ground: ImageArray, rng: np.random.Generator, cue: bool = False
) -> tuple[ImageArray, ImageArray, None]:
    """The ball is gone; a cue may lie at its place."""
    image = add_noise(ground, rng)
    if cue:
        cv2.line(image, (30, 44), (80, 56), (235, 225, 190), 5)
    return image, np.zeros((SIZE, SIZE), dtype=np.uint8), None


def add_noise(ground: ImageArray, rng: np.random.Generator) -> ImageArray:
    return np.clip(ground + rng.normal(0, 1.5, ground.shape), 0, 255).astype(np.uint8)


def largest_error(plate: BackgroundPlate, truth: ImageArray) -> float:
    """Largest error of the plate in levels."""
    return float(np.abs(plate.image[REGION].astype(float) - truth[REGION]).max())


def test_a_cue_that_rests_at_the_place_of_the_ball_is_no_table() -> None:
    rng = np.random.default_rng(2)
    samples = [
        *(frame_with_ball(cloth(), rng) for _ in range(5)),
        *(frame_without_ball(cloth(), rng, cue=True) for _ in range(15)),
    ]
    assert largest_error(estimate_background_plate(REGION, samples), cloth()) < 12


def test_a_line_on_the_cloth_stays_where_a_ball_was() -> None:
    rng, ground = np.random.default_rng(3), cloth(marked=True)
    samples = [*(frame_with_ball(ground, rng) for _ in range(5)), *(frame_without_ball(ground, rng) for _ in range(15))]
    assert largest_error(estimate_background_plate(REGION, samples), ground) < 8


def test_pixels_that_are_never_uncovered_are_inpainted_smoothly() -> None:
    rng = np.random.default_rng(4)
    plate = estimate_background_plate(REGION, [frame_with_ball(cloth(), rng) for _ in range(9)])
    assert plate.valid[REGION].all()
    assert largest_error(plate, cloth()) < 6
