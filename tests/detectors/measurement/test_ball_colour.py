"""White share and colours of balls in any light."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from detectors.measurement.ball_colour import find_flat_discs, measure_ball_colours
from models.core.typing import FloatArray

RADIUS = 14
LIGHTS = {"white": (1.0, 1.0, 1.0), "lamp": (1.0, 0.86, 0.55), "green": (0.75, 1.0, 0.7)}


def table(
    balls: list[tuple[str, tuple[int, int, int]]], light: str
) -> tuple[NDArray[np.uint8], FloatArray, FloatArray]:
    """Balls in a row, shaded towards their rims: `plain`, with a `number` or with white `caps` beside a stripe."""
    image = np.full((60, 60 * len(balls), 3), (40, 90, 140), dtype=np.float64)
    centre = np.array([[30.0 + 60 * k, 30.0] for k in range(len(balls))])
    y, x = np.mgrid[:60, : 60 * len(balls)]
    for (kind, colour), (cx, cy) in zip(balls, centre, strict=True):
        away = np.hypot(x - cx, y - cy) / RADIUS
        paint = np.broadcast_to(np.array(colour, dtype=np.float64), image.shape).copy()
        if kind == "number":
            paint[np.hypot(x - cx - 3, y - cy) < 0.38 * RADIUS] = 245
        if kind == "caps":
            paint[np.abs(y - cy) > 0.5 * RADIUS] = 245
        shade = np.sqrt(np.clip(1 - 0.75 * np.minimum(away, 1) ** 2, 0, 1))
        image = np.where((away < 1)[..., None], paint * shade[..., None], image)
    lit = cv2.GaussianBlur(image * LIGHTS[light], (0, 0), 0.8)
    return np.asarray(np.clip(lit, 0, 255), dtype=np.uint8), centre, np.full(len(balls), float(RADIUS))


@pytest.mark.parametrize("light", LIGHTS)
def test_white_is_separated_from_colour_in_any_light(light: str) -> None:
    colours = ((200, 30, 40), (30, 60, 170), (230, 180, 20))
    balls = [("plain", (245, 245, 245))]
    balls += [(kind, colour) for kind in ("plain", "number", "caps") for colour in colours]
    coats = measure_ball_colours(*table(balls, light))
    assert coats.white[0] > 0.75
    plain, number, caps = coats.white[1:4], coats.white[4:7], coats.white[7:]
    assert plain.max() < 0.05
    assert number.max() < 0.2
    assert caps.min() > 0.22
    assert coats.white_rim[4:7].max() < 0.5 * number.min()
    assert coats.white_rim[7:].min() > 0.22


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("kind", ["plain", "number"])
def test_only_black_is_dark_in_every_channel(light: str, kind: str) -> None:
    colours = ((18, 18, 20), (30, 30, 110), (110, 20, 40), (15, 80, 50))
    white = ("plain", (245, 245, 245))
    value = measure_ball_colours(*table([white, *[(kind, colour) for colour in colours]], light)).value
    assert value[1] < 0.6 * value[2:].min()


def test_a_lone_coloured_ball_is_not_white() -> None:
    for colour in ((200, 30, 40), (240, 200, 30), (240, 130, 160)):
        assert measure_ball_colours(*table([("plain", colour)], "white")).white[0] < 0.1


def test_nothing_has_no_colour() -> None:
    coats = measure_ball_colours(np.zeros((10, 10, 3), np.uint8), np.empty((0, 2)), np.empty(0))
    assert coats.colour.shape == (0, 3)
    assert coats.white.shape == coats.white_rim.shape == coats.value.shape == (0,)


def test_a_small_drawn_disc_is_flat_although_its_colour_is_coded_at_half_the_resolution() -> None:
    """The edge of the disc reaches its middle in colour, not in luma; a matte ball is darker at its rim."""
    y, x = np.mgrid[:40, :80]
    away = np.stack([np.hypot(x - cx, y - 20) / 6.0 for cx in (20, 60)])
    cloth, red = np.array([20.0, 140.0, 50.0]), np.array([255.0, 40.0, 40.0])
    cover = cv2.GaussianBlur((away < 1).astype(np.float64).transpose(1, 2, 0), (0, 0), 0.4)
    shade = np.where(
        np.arange(2) == 0, 1.0, np.sqrt(np.clip(1 - 0.75 * np.minimum(away, 1) ** 2, 0, 1)).transpose(1, 2, 0)
    )
    image = sum(cover[..., k, None] * red * shade[..., k, None] for k in range(2))
    image = np.asarray(np.rint(image + (1 - cover.sum(axis=2, keepdims=True)) * cloth), np.uint8)
    coded = cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb)
    coded[..., 1:] = cv2.resize(cv2.resize(coded[..., 1:], (40, 20), interpolation=cv2.INTER_AREA), (80, 40))
    decoded = cv2.cvtColor(coded, cv2.COLOR_YCrCb2RGB)
    centre = np.array([[20.0, 20.0], [60.0, 20.0]])
    assert find_flat_discs(np.asarray(decoded, np.uint8), centre, np.full(2, 6.0)).tolist() == [True, False]


@pytest.mark.parametrize(("level", "shadow", "is_flat"), [(245.0, 0.0, True), (245.0, 0.2, False), (12.0, 0.0, True)])
def test_a_drawn_disc_is_flat_also_where_it_is_white_or_black(level: float, shadow: float, is_flat: bool) -> None:
    """An overexposed ball shows no shading either, but keeps light from the cloth on one side at least."""
    y, x = np.mgrid[:80, :80]
    away = np.hypot(x - 40, y - 40) / 10.0
    cloth = np.array([20.0, 140.0, 50.0]) * (1 - shadow * np.exp(-((np.hypot(x - 44, y - 40) / 15.0) ** 4)))[..., None]
    cover = cv2.GaussianBlur((away < 1).astype(np.float64), (0, 0), 0.5)[..., None]
    image = cover * level + (1 - cover) * cloth + np.random.default_rng(1).normal(0, 0.8, (80, 80, 1))
    found = find_flat_discs(np.clip(image, 0, 255).astype(np.uint8), np.full((1, 2), 40.0), np.full(1, 10.0))
    assert found.tolist() == [is_flat]
