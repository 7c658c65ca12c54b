"""Streaks are deblurred and synthesized, compared with balls whose sharp image is known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from models.core.typing import FloatArray, ImageArray
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import BallOutline, MattedSprite, matte_balls, sample_path
from video.matting.compositing import SpriteLayer, composite_balls
from video.matting.sharp_balls import (
    blur_along_path,
    deblur_sprite,
    match_brightness,
    scale_sprite,
    smooth_shading_over_borders,
)

SIZE, RADIUS, CENTRE = 96, 9.0, np.array([47.3, 48.6])
CLOTH, BALL = np.array([40.0, 110.0, 80.0]), np.array([230.0, 60.0, 40.0])


def film_ball(path: FloatArray) -> ImageArray:
    """A lit ball filmed along `path` (K, 2) px around the centre: the mean over its places."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    total = np.zeros((SIZE, SIZE, 3))
    for place in CENTRE + path:
        distance = np.hypot(x - place[0], y - place[1])
        mask = np.clip(RADIUS + 0.5 - distance, 0, 1)[..., None]
        total += CLOTH * (1 - mask) + BALL * (1 - 0.5 * np.clip(distance / RADIUS, 0, 1) ** 2)[..., None] * mask
    return np.asarray(np.rint(total / len(path)), dtype=np.uint8)


def line(dx: float, dy: float, count: int = 41) -> FloatArray:
    return np.asarray(np.linspace(-0.5, 0.5, count)[:, None] * np.array([[dx, dy]]), dtype=np.float64)


def matte_ball(image: ImageArray, path: FloatArray) -> tuple[ImageArray, MattedSprite]:
    plate = BackgroundPlate(np.full((SIZE, SIZE, 3), CLOTH, dtype=np.uint8), np.ones((SIZE, SIZE), dtype=bool))
    matted = matte_balls(image, [BallOutline(CENTRE + path, CENTRE, RADIUS)], [], plate, None)
    assert matted.sprites[0] is not None
    return matted.background, matted.sprites[0]


def mean_square_error(a: ImageArray, b: ImageArray) -> float:
    return float(((a.astype(float) - b) ** 2).mean())


def test_a_sharp_ball_blurred_along_a_path_looks_as_filmed_with_a_longer_shutter_time() -> None:
    background, sharp = matte_ball(film_ball(np.zeros((1, 2))), np.zeros((1, 2)))
    for path in (line(10, 0), line(-6, 9), np.concatenate([line(8, 0)[:21], line(8, 0)[20] + line(0, 8) + [0, 4]])):
        composited = background.copy()
        composite_balls(composited, [[SpriteLayer(sharp, CENTRE + sample_path(path), 1.0)]])
        truth = film_ball(path)
        assert mean_square_error(composited, truth) < 0.05 * mean_square_error(film_ball(np.zeros((1, 2))), truth)


@pytest.mark.parametrize("length", [7.0, 12.0])
def test_a_deblurred_streak_is_closer_to_the_sharp_ball(length: float) -> None:
    path = line(length, 0.4 * length)
    background, blurred = matte_ball(film_ball(path), path)
    composited = background.copy()
    composite_balls(composited, [[SpriteLayer(deblur_sprite(blurred, RADIUS), CENTRE[None], 1.0)]])
    truth = film_ball(np.zeros((1, 2)))
    assert mean_square_error(composited, truth) < 0.35 * mean_square_error(film_ball(path), truth)
    assert deblur_sprite(blurred, RADIUS).streak_length == 0


def test_a_streak_composited_at_its_place_restores_the_frame() -> None:
    path = line(12, 5)
    image = film_ball(path)
    background, blurred = matte_ball(image, path)
    composited = background.copy()
    composite_balls(composited, [[SpriteLayer(blurred, CENTRE[None], 1.0)]])
    assert np.abs(composited.astype(int) - image).max() <= 8


def test_blurring_keeps_the_sum_and_the_direction() -> None:
    patch = np.zeros((41, 41, 1), dtype=np.float32)
    patch[20, 20] = 1
    blurred_patch = blur_along_path(patch, np.array([[0.0, 0.0], [6.0, 2.5]]))[..., 0]
    assert blurred_patch.sum() == pytest.approx(1, abs=1e-5)
    y, x = np.nonzero(blurred_patch > 0.2)
    assert x.max() == 26
    assert y.max() in (22, 23)


def test_a_ball_takes_the_light_and_the_size_of_another_view() -> None:
    _, sharp = matte_ball(film_ball(np.zeros((1, 2))), np.zeros((1, 2)))
    darker = replace(sharp, rgba=sharp.rgba * np.array([0.7, 0.7, 0.7, 1], dtype=np.float32))
    dim = match_brightness(sharp, darker)
    np.testing.assert_allclose(dim.rgba[..., :3], 0.7 * sharp.rgba[..., :3], rtol=0.02, atol=0.5)
    large = scale_sprite(sharp, 1.3)
    assert large.rgba[..., 3].sum() == pytest.approx(1.3**2 * sharp.rgba[..., 3].sum(), rel=0.03)
    assert scale_sprite(sharp, 1.005) is sharp


def test_an_overexposed_streak_keeps_its_bright_ends() -> None:
    path = line(12, 5)
    dim = film_ball(path).astype(float)
    image = np.clip(dim + 3 * np.maximum(dim - CLOTH, 0), 0, 255).astype(np.uint8)
    background, blurred = matte_ball(image, path)
    composited = background.copy()
    composite_balls(composited, [[SpriteLayer(blurred, CENTRE[None], 1.0)]])
    assert np.abs(composited.astype(int) - image).max() <= 8


def beside_a_pocket(rng: np.random.Generator, above: float) -> ImageArray:
    """The cloth with a dark pocket `above` px from the ball's centre, whose few levels are noise."""
    ground = np.full((SIZE, SIZE, 3), CLOTH)
    ground[: int(CENTRE[1] - above)] = 3
    ground = cv2.GaussianBlur(ground, (0, 0), 2.0)
    return np.clip(ground + rng.normal(0, 1.2, ground.shape), 0, 255).astype(np.uint8)


def test_the_shading_of_a_ball_beside_a_pocket_holds_no_noise_of_the_pocket() -> None:
    """Nor the pocket's border, which two frames show a pixel apart, where the sprite is used elsewhere."""
    rng = np.random.default_rng(1)
    plate = BackgroundPlate(beside_a_pocket(rng, RADIUS + 5), np.ones((SIZE, SIZE), dtype=bool))
    distance = np.hypot(*(np.mgrid[0:SIZE, 0:SIZE] - CENTRE[::-1, None, None]))[..., None]
    image = np.where(distance < RADIUS, BALL, beside_a_pocket(rng, RADIUS + 5.5)).astype(np.uint8)
    matted = matte_balls(image, [BallOutline(CENTRE[None], CENTRE, RADIUS)], [], plate, None)
    sprite = matted.sprites[0]
    assert sprite is not None
    above = np.s_[: int(CENTRE[1] - RADIUS - 2) - sprite.y]
    assert np.abs(sprite.shading[above]).max() > 0.12
    plain = smooth_shading_over_borders(sprite, matted.background)
    assert np.abs(plain.shading[above]).max() < 0.05


def test_a_shadow_on_plain_cloth_is_unchanged() -> None:
    image = film_ball(np.zeros((1, 2)))
    image[int(CENTRE[1] + RADIUS) + 2 :, 40:55][:4] = (0.7 * CLOTH).astype(np.uint8)
    background, sprite = matte_ball(image, np.zeros((1, 2)))
    assert sprite.shading.min() == pytest.approx(-0.3, abs=0.02)
    assert smooth_shading_over_borders(sprite, background) is sprite
