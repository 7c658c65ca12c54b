"""Streaks undone and made anew, against balls whose sharp look is known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from models.core.typing import FloatArray, ImageArray
from video.matting.background_plate import Plate
from video.matting.ball_matting import Outline, Sprite, peel, taps_along
from video.matting.compositing import Layer, paste
from video.matting.deblur import grown, lit_like, sharpened, streaked
from video.matting.sharp_balls import over_plain_ground

SIZE, RADIUS, CENTRE = 96, 9.0, np.array([47.3, 48.6])
CLOTH, BALL = np.array([40.0, 110.0, 80.0]), np.array([230.0, 60.0, 40.0])


def exposed(way: FloatArray) -> ImageArray:
    """A lit ball filmed while it goes along `way` (K, 2) px around the centre: the mean over its places."""
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    total = np.zeros((SIZE, SIZE, 3))
    for place in CENTRE + way:
        apart = np.hypot(x - place[0], y - place[1])
        mask = np.clip(RADIUS + 0.5 - apart, 0, 1)[..., None]
        total += CLOTH * (1 - mask) + BALL * (1 - 0.5 * np.clip(apart / RADIUS, 0, 1) ** 2)[..., None] * mask
    return np.asarray(np.rint(total / len(way)), dtype=np.uint8)


def line(dx: float, dy: float, count: int = 41) -> FloatArray:
    return np.asarray(np.linspace(-0.5, 0.5, count)[:, None] * np.array([[dx, dy]]), dtype=np.float64)


def cut(picture: ImageArray, way: FloatArray) -> tuple[ImageArray, Sprite]:
    plate = Plate(np.full((SIZE, SIZE, 3), CLOTH, dtype=np.uint8), np.ones((SIZE, SIZE), dtype=bool))
    peeled = peel(picture, [Outline(CENTRE + way, CENTRE, RADIUS)], [], plate, None)
    assert peeled.sprites[0] is not None
    return peeled.behind, peeled.sprites[0]


def off(a: ImageArray, b: ImageArray) -> float:
    return float(((a.astype(float) - b) ** 2).mean())


def test_a_sharp_ball_streaked_anew_is_what_a_longer_exposure_films() -> None:
    behind, sharp = cut(exposed(np.zeros((1, 2))), np.zeros((1, 2)))
    for way in (line(10, 0), line(-6, 9), np.concatenate([line(8, 0)[:21], line(8, 0)[20] + line(0, 8) + [0, 4]])):
        made = behind.copy()
        paste(made, [[Layer(sharp, CENTRE + taps_along(way), 1.0)]])
        truth = exposed(way)
        assert off(made, truth) < 0.05 * off(exposed(np.zeros((1, 2))), truth)


@pytest.mark.parametrize("length", [7.0, 12.0])
def test_a_streak_undone_is_nearer_to_the_sharp_ball(length: float) -> None:
    way = line(length, 0.4 * length)
    behind, blurred = cut(exposed(way), way)
    made = behind.copy()
    paste(made, [[Layer(sharpened(blurred, RADIUS), CENTRE[None], 1.0)]])
    truth = exposed(np.zeros((1, 2)))
    assert off(made, truth) < 0.35 * off(exposed(way), truth)
    assert sharpened(blurred, RADIUS).streak == 0


def test_a_streak_pasted_where_it_was_gives_the_picture_back() -> None:
    way = line(12, 5)
    picture = exposed(way)
    behind, blurred = cut(picture, way)
    made = behind.copy()
    paste(made, [[Layer(blurred, CENTRE[None], 1.0)]])
    assert np.abs(made.astype(int) - picture).max() <= 8


def test_streaking_keeps_the_sum_and_points_the_way_it_went() -> None:
    patch = np.zeros((41, 41, 1), dtype=np.float32)
    patch[20, 20] = 1
    seen = streaked(patch, np.array([[0.0, 0.0], [6.0, 2.5]]))[..., 0]
    assert seen.sum() == pytest.approx(1, abs=1e-5)
    y, x = np.nonzero(seen > 0.2)
    assert x.max() == 26
    assert y.max() in (22, 23)


def test_a_ball_takes_the_light_and_the_size_of_another_sighting() -> None:
    _, sharp = cut(exposed(np.zeros((1, 2))), np.zeros((1, 2)))
    darker = replace(sharp, cover=sharp.cover * np.array([0.7, 0.7, 0.7, 1], dtype=np.float32))
    dim = lit_like(sharp, darker)
    np.testing.assert_allclose(dim.cover[..., :3], 0.7 * sharp.cover[..., :3], rtol=0.02, atol=0.5)
    large = grown(sharp, 1.3)
    assert large.cover[..., 3].sum() == pytest.approx(1.3**2 * sharp.cover[..., 3].sum(), rel=0.03)
    assert grown(sharp, 1.005) is sharp


def test_an_overexposed_streak_keeps_its_bright_ends() -> None:
    way = line(12, 5)
    dim = exposed(way).astype(float)
    picture = np.clip(dim + 3 * np.maximum(dim - CLOTH, 0), 0, 255).astype(np.uint8)
    behind, blurred = cut(picture, way)
    made = behind.copy()
    paste(made, [[Layer(blurred, CENTRE[None], 1.0)]])
    assert np.abs(made.astype(int) - picture).max() <= 8


def beside_a_pocket(rng: np.random.Generator, above: float) -> ImageArray:
    """The cloth with a dark pocket `above` px from the ball's centre, whose few levels are noise."""
    ground = np.full((SIZE, SIZE, 3), CLOTH)
    ground[: int(CENTRE[1] - above)] = 3
    ground = cv2.GaussianBlur(ground, (0, 0), 2.0)
    return np.clip(ground + rng.normal(0, 1.2, ground.shape), 0, 255).astype(np.uint8)


def test_a_ball_beside_a_pocket_takes_none_of_its_noise_along() -> None:
    """Nor of the pocket's border, which two pictures show a pixel apart, where it is used elsewhere."""
    rng = np.random.default_rng(1)
    plate = Plate(beside_a_pocket(rng, RADIUS + 5), np.ones((SIZE, SIZE), dtype=bool))
    apart = np.hypot(*(np.mgrid[0:SIZE, 0:SIZE] - CENTRE[::-1, None, None]))[..., None]
    picture = np.where(apart < RADIUS, BALL, beside_a_pocket(rng, RADIUS + 5.5)).astype(np.uint8)
    peeled = peel(picture, [Outline(CENTRE[None], CENTRE, RADIUS)], [], plate, None)
    sprite = peeled.sprites[0]
    assert sprite is not None
    above = np.s_[: int(CENTRE[1] - RADIUS - 2) - sprite.y]
    assert np.abs(sprite.shade[above]).max() > 0.12
    plain = over_plain_ground(sprite, peeled.behind)
    assert np.abs(plain.shade[above]).max() < 0.05


def test_a_shadow_on_plain_cloth_is_kept_as_it_is() -> None:
    picture = exposed(np.zeros((1, 2)))
    picture[int(CENTRE[1] + RADIUS) + 2 :, 40:55][:4] = (0.7 * CLOTH).astype(np.uint8)
    behind, sprite = cut(picture, np.zeros((1, 2)))
    assert sprite.shade.min() == pytest.approx(-0.3, abs=0.02)
    assert over_plain_ground(sprite, behind) is sprite
