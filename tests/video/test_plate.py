from __future__ import annotations

import cv2
import numpy as np

from models.core.typing import ImageArray
from video.matting.background_plate import SHADED, UNDER, Plate, learn_plate

SIZE, BALL, RADIUS = 96, (40, 48), 8
SWEPT = np.zeros((SIZE, SIZE), dtype=bool)
SWEPT[22:74, 10:86] = True


def cloth(marked: bool = False) -> ImageArray:
    """A green gradient; marked: with a white line across."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    ground = np.stack([20 + x / 12, 110 + y / 6, 70 + x / 12], axis=-1).astype(np.uint8)
    if marked:
        ground[46:50] = 230
    return ground


def before(ground: ImageArray, rng: np.random.Generator) -> tuple[ImageArray, ImageArray, None]:
    """The ball rests; what it covers and shades."""
    picture, covered = noisy(ground, rng), np.zeros((SIZE, SIZE), dtype=np.uint8)
    cv2.circle(picture, BALL, RADIUS, (240, 240, 220), -1)
    cv2.circle(covered, BALL, 2 * RADIUS, SHADED, -1)
    cv2.circle(covered, BALL, RADIUS + 2, UNDER, -1)
    return picture, covered, None


def after(ground: ImageArray, rng: np.random.Generator, cue: bool = False) -> tuple[ImageArray, ImageArray, None]:
    """The ball is gone, and perhaps a cue lies where it was."""
    picture = noisy(ground, rng)
    if cue:
        cv2.line(picture, (30, 44), (80, 56), (235, 225, 190), 5)
    return picture, np.zeros((SIZE, SIZE), dtype=np.uint8), None


def noisy(ground: ImageArray, rng: np.random.Generator) -> ImageArray:
    return np.clip(ground + rng.normal(0, 1.5, ground.shape), 0, 255).astype(np.uint8)


def missed(plate: Plate, truth: ImageArray) -> float:
    """Levels by which the plate is off at the worst pixel."""
    return float(np.abs(plate.picture[SWEPT].astype(float) - truth[SWEPT]).max())


def test_a_cue_that_stays_where_the_ball_lay_is_no_table() -> None:
    rng = np.random.default_rng(2)
    samples = [*(before(cloth(), rng) for _ in range(5)), *(after(cloth(), rng, cue=True) for _ in range(15))]
    assert missed(learn_plate(SWEPT, samples), cloth()) < 12


def test_a_line_on_the_cloth_stays_where_a_ball_lay_on_it() -> None:
    rng, ground = np.random.default_rng(3), cloth(marked=True)
    samples = [*(before(ground, rng) for _ in range(5)), *(after(ground, rng) for _ in range(15))]
    assert missed(learn_plate(SWEPT, samples), ground) < 8


def test_what_is_never_free_goes_over_smoothly_into_what_is() -> None:
    rng = np.random.default_rng(4)
    plate = learn_plate(SWEPT, [before(cloth(), rng) for _ in range(9)])
    assert plate.known[SWEPT].all()
    assert missed(plate, cloth()) < 6
