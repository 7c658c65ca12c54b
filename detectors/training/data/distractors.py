"""Distractors: objects on the cloth that resemble balls, painted into rendered training images beneath the balls.

Flat discs and rings of a ball's size, letters, patches of shade, streaks of light: only shading and outline distinguish
a ball from them.
"""

from __future__ import annotations

import string
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, FloatArray

# Most distractors in one image.
MAX_DISTRACTORS = 5
# Limits of the size of a distractor, ball radii.
SIZE_LIMITS_RADII = (0.6, 2.2)
# Limits of the foreshortening of flat distractors; a disc that is not foreshortened could be a dull ball.
FLATNESS_LIMITS = (0.3, 0.75)
# Share of the rings around a ball, as projectors show them.
RING_ABOUT_BALL_SHARE = 0.3
# Radius about a ball's centre, ball radii, within which nothing is painted.
PROTECTED_RADII = 1.08
# Ball radius assumed in an image without balls.
DEFAULT_RADIUS_PX = 7.0
# Binary digits of a pixel's fraction in OpenCV's drawing functions.
SUBPIXEL_BITS = 4


def paint_distractors(rng: np.random.Generator, rgb: ByteArray, balls: Float32Array) -> ByteArray:
    """Paint random distractors beneath the balls of an image.

    Args:
        rng: Random generator.
        rgb: Image (S, S, 3).
        balls: Its balls (N, 7), columns as in `training_shards.COLUMNS`.

    Returns:
        Image (S, S, 3).
    """
    there = balls[np.isfinite(balls[:, 0])].astype(np.float64)
    radius = float(np.median(there[:, 2])) if len(there) else DEFAULT_RADIUS_PX
    flat = float(rng.uniform(*FLATNESS_LIMITS))
    painted = rgb.astype(np.float32)
    for _ in range(int(rng.integers(1, MAX_DISTRACTORS + 1))):
        paint = PAINTERS[rng.integers(len(PAINTERS))]
        cover = np.zeros(rgb.shape[:2], np.uint8)
        at, size = rng.uniform(0, 1, 2) * rgb.shape[1::-1], radius * float(rng.uniform(*SIZE_LIMITS_RADII))
        if paint is _paint_ring and len(there) and rng.random() < RING_ABOUT_BALL_SHARE:
            at = there[rng.integers(len(there)), :2] + (0, 0.4 * radius)
        paint(rng, cover, at, size, flat)
        share = rng.uniform(0.25, 1.0) * cv2.GaussianBlur(cover, (0, 0), rng.uniform(0.5, 1.2)).astype(np.float32) / 255
        painted += share[..., None] * (_draw_colour(rng, rgb) - painted)
    noise = rng.normal(0, rng.uniform(0, 3), rgb.shape[:2])[..., None]
    noisy = np.clip(painted + noise * (np.abs(painted - rgb) > 1), 0, 255).astype(np.uint8)
    return np.where(_is_on_balls(there, rgb.shape[0])[..., None], rgb, noisy)


def _draw_colour(rng: np.random.Generator, rgb: ByteArray) -> Float32Array:
    """Draw any colour, black or white, or one of the image's own."""
    own = rgb[rng.integers(rgb.shape[0]), rng.integers(rgb.shape[1])] * rng.uniform(0.3, 1.6)
    other = rng.uniform(0, 255) + rng.normal(0, 60, 3)
    return np.clip(own if rng.random() < 0.4 else other, 0, 255).astype(np.float32)


def _is_on_balls(balls: FloatArray, side: int) -> NDArray[np.bool_]:
    """Where (S, S) a ball is at some time of the exposure."""
    drawn = np.zeros((side, side), np.uint8)
    for x, y, radius, dx, dy in balls[:, :5]:
        ends = [tuple(np.rint((x + k * dx, y + k * dy)).astype(int).tolist()) for k in (-0.5, 0.5)]
        cv2.line(drawn, ends[0], ends[1], 1, max(round(2 * PROTECTED_RADII * radius), 1))
        for end in ends:
            cv2.circle(drawn, end, round(PROTECTED_RADII * radius), 1, -1)
    return drawn.view(np.bool_)


def _paint_ellipse(cover: ByteArray, at: FloatArray, size: float, flat: float, thick: int) -> None:
    middle, axes = (
        np.rint(at * 2**SUBPIXEL_BITS).astype(int),
        np.rint(np.array([size, flat * size]) * 2**SUBPIXEL_BITS).astype(int),
    )
    cv2.ellipse(cover, middle.tolist(), axes.tolist(), 0, 0, 360, 255, thick, cv2.LINE_AA, SUBPIXEL_BITS)


def _paint_disc(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """Paint a sticker, a hole or a patch of shade."""
    _paint_ellipse(cover, at, size, flat, -1)


def _paint_ring(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """Paint a ring of light, an O or the lit lining of a pocket."""
    _paint_ellipse(cover, at, size, flat, max(1, round(float(rng.uniform(0.1, 0.45)) * size)))


def _paint_crescent(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """Paint the lit part of a round object."""
    _paint_ellipse(cover, at, size, flat, -1)
    away = at + rng.normal(0, 0.5, 2) * size
    aside = np.zeros_like(cover)
    _paint_ellipse(aside, away, size * float(rng.uniform(0.7, 1.2)), flat, -1)
    cover[aside > 0] = 0


def _paint_letters(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """Paint letters in any orientation."""
    flat_letters = np.zeros((64, 128), np.uint8)
    text = "".join(rng.choice(list(string.ascii_letters + string.digits), int(rng.integers(1, 4))))
    cv2.putText(flat_letters, text, (8, 50), int(rng.integers(0, 8)), 1.4, 255, int(rng.integers(3, 12)), cv2.LINE_AA)
    turn = rng.uniform(0, 2 * np.pi)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = np.diag([1.0, flat]) @ spin * 2 * size / 40
    matrix = np.column_stack([linear, at - linear @ [64, 32]])
    cover[:] = cv2.warpAffine(flat_letters, matrix, cover.shape[::-1], flags=cv2.INTER_LINEAR)


def _paint_smear(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """Paint a stroke of chalk, a reflection or a seam: as long as a streak, but narrower."""
    way = rng.normal(size=2) * (1.0, flat) * size * rng.uniform(1.0, 4.0)
    ends = np.rint(np.array([at - way / 2, at + way / 2]) * 2**SUBPIXEL_BITS).astype(int).tolist()
    cv2.line(
        cover, ends[0], ends[1], 255, max(1, round(size * float(rng.uniform(0.15, 0.6)))), cv2.LINE_AA, SUBPIXEL_BITS
    )


PAINTERS: tuple[Callable[[np.random.Generator, ByteArray, FloatArray, float, float], None], ...] = (
    _paint_disc, _paint_ring, _paint_crescent, _paint_letters, _paint_smear
)  # fmt: skip
