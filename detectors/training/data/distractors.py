"""What lies on a cloth and looks like a ball at first sight, painted into finished training pictures.

Flat discs and rings of a ball's size, letters, patches of shade, streaks of light: whatever a ball is told from by its
light and its outline alone. All of it lies beneath the balls.
"""

from __future__ import annotations

import string
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, FloatArray

MOST_PIECES = 5
SIZES = (0.6, 2.2)
"""Of a piece, radii of the balls."""
FLATNESS = (0.3, 0.75)
"""How far a camera presses together what lies flat on the table; a round disc may well be a dull ball."""
RINGED_SHARE = 0.3
"""Share of the rings that lie about a ball, as projectors draw them."""
BALL_RADII = 1.08
"""About a ball's centre nothing is painted within this."""
UNKNOWN_RADIUS_PX = 7.0
"""Of the balls of a picture without any."""
SHIFT = 4
"""Bits of a pixel's fraction in cv2's drawing."""


def littered(rng: np.random.Generator, rgb: ByteArray, balls: Float32Array) -> ByteArray:
    """A picture (S, S, 3) with litter beneath its balls (N, 7), columns as in `training_data.COLUMNS`."""
    there = balls[np.isfinite(balls[:, 0])].astype(np.float64)
    radius = float(np.median(there[:, 2])) if len(there) else UNKNOWN_RADIUS_PX
    flat = float(rng.uniform(*FLATNESS))
    picture = rgb.astype(np.float32)
    for _ in range(int(rng.integers(1, MOST_PIECES + 1))):
        paint = PAINTERS[rng.integers(len(PAINTERS))]
        cover = np.zeros(rgb.shape[:2], np.uint8)
        at, size = rng.uniform(0, 1, 2) * rgb.shape[1::-1], radius * float(rng.uniform(*SIZES))
        if paint is _ring and len(there) and rng.random() < RINGED_SHARE:
            at = there[rng.integers(len(there)), :2] + (0, 0.4 * radius)
        paint(rng, cover, at, size, flat)
        share = rng.uniform(0.25, 1.0) * cv2.GaussianBlur(cover, (0, 0), rng.uniform(0.5, 1.2)).astype(np.float32) / 255
        picture += share[..., None] * (_colour(rng, rgb) - picture)
    noise = rng.normal(0, rng.uniform(0, 3), rgb.shape[:2])[..., None]
    painted = np.clip(picture + noise * (np.abs(picture - rgb) > 1), 0, 255).astype(np.uint8)
    return np.where(_on_balls(there, rgb.shape[0])[..., None], rgb, painted)


def _colour(rng: np.random.Generator, rgb: ByteArray) -> Float32Array:
    """Any colour, black or white, or one of the picture's own."""
    own = rgb[rng.integers(rgb.shape[0]), rng.integers(rgb.shape[1])] * rng.uniform(0.3, 1.6)
    other = rng.uniform(0, 255) + rng.normal(0, 60, 3)
    return np.clip(own if rng.random() < 0.4 else other, 0, 255).astype(np.float32)


def _on_balls(balls: FloatArray, side: int) -> NDArray[np.bool_]:
    """Where (S, S) a ball is at some time of the exposure."""
    drawn = np.zeros((side, side), np.uint8)
    for x, y, radius, dx, dy in balls[:, :5]:
        ends = [tuple(np.rint((x + k * dx, y + k * dy)).astype(int).tolist()) for k in (-0.5, 0.5)]
        cv2.line(drawn, ends[0], ends[1], 1, max(round(2 * BALL_RADII * radius), 1))
        for end in ends:
            cv2.circle(drawn, end, round(BALL_RADII * radius), 1, -1)
    return drawn.view(np.bool_)


def _ellipse(cover: ByteArray, at: FloatArray, size: float, flat: float, thick: int) -> None:
    middle, axes = np.rint(at * 2**SHIFT).astype(int), np.rint(np.array([size, flat * size]) * 2**SHIFT).astype(int)
    cv2.ellipse(cover, middle.tolist(), axes.tolist(), 0, 0, 360, 255, thick, cv2.LINE_AA, SHIFT)


def _disc(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """A sticker, a hole, a patch of shade."""
    _ellipse(cover, at, size, flat, -1)


def _ring(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """A ring of light, an O, the lit lining of a pocket."""
    _ellipse(cover, at, size, flat, max(1, round(float(rng.uniform(0.1, 0.45)) * size)))


def _crescent(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """What a lamp lights of a round thing."""
    _ellipse(cover, at, size, flat, -1)
    away = at + rng.normal(0, 0.5, 2) * size
    aside = np.zeros_like(cover)
    _ellipse(aside, away, size * float(rng.uniform(0.7, 1.2)), flat, -1)
    cover[aside > 0] = 0


def _letter(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """Letters, turned any way."""
    flat_letters = np.zeros((64, 128), np.uint8)
    text = "".join(rng.choice(list(string.ascii_letters + string.digits), int(rng.integers(1, 4))))
    cv2.putText(flat_letters, text, (8, 50), int(rng.integers(0, 8)), 1.4, 255, int(rng.integers(3, 12)), cv2.LINE_AA)
    turn = rng.uniform(0, 2 * np.pi)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = np.diag([1.0, flat]) @ spin * 2 * size / 40
    matrix = np.column_stack([linear, at - linear @ [64, 32]])
    cover[:] = cv2.warpAffine(flat_letters, matrix, cover.shape[::-1], flags=cv2.INTER_LINEAR)


def _smear(rng: np.random.Generator, cover: ByteArray, at: FloatArray, size: float, flat: float) -> None:
    """A stroke of chalk, a reflection, a seam: as long as a streak, but narrower."""
    way = rng.normal(size=2) * (1.0, flat) * size * rng.uniform(1.0, 4.0)
    ends = np.rint(np.array([at - way / 2, at + way / 2]) * 2**SHIFT).astype(int).tolist()
    cv2.line(cover, ends[0], ends[1], 255, max(1, round(size * float(rng.uniform(0.15, 0.6)))), cv2.LINE_AA, SHIFT)


PAINTERS: tuple[Callable[[np.random.Generator, ByteArray, FloatArray, float, float], None], ...] = (
    _disc, _ring, _crescent, _letter, _smear
)  # fmt: skip
