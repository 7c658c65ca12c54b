"""Augmentation of training images: symmetries, rotation, scale, light, noise, and objects that resemble balls."""

from __future__ import annotations

import string
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, FloatArray

# Share of images rotated by any angle and scaled, of those with distractors, and of those in another light.
ZOOMED_SHARE, DISTRACTOR_SHARE, LIGHT_SHARE = 0.5, 0.4, 0.7
# Limits of the scaling.
ZOOM_LIMITS = (0.75, 1.35)
# Limits of the radii after scaling: those that the network is made for.
RADIUS_LIMITS_PX = (3.5, 13.0)
# Column of `training_shards.COLUMNS`.
VISIBLE_COLUMN = 6


def augment_image(rng: np.random.Generator, rgb: ByteArray, balls: Float32Array) -> tuple[ByteArray, Float32Array]:
    """Augment an image at random.

    Args:
        rng: Random generator.
        rgb: Image (S, S, 3).
        balls: Its balls (N, 7), columns as in `training_shards.COLUMNS`.

    Returns:
        The augmented image and its balls.
    """
    rgb, balls = apply_square_symmetry(rgb, balls, int(rng.integers(8)))
    if rng.random() < ZOOMED_SHARE:
        rgb, balls = _zoom_randomly(rng, rgb, balls)
    if rng.random() < DISTRACTOR_SHARE:
        rgb = paint_distractors(rng, rgb, balls)
    if rng.random() < LIGHT_SHARE:
        rgb = _change_light(rng, rgb)
    return rgb, balls


def apply_square_symmetry(rgb: ByteArray, balls: Float32Array, symmetry: int) -> tuple[ByteArray, Float32Array]:
    """Apply one of the eight symmetries of a square to an image (S, S, 3) and its balls (N, 7)."""
    last = rgb.shape[0] - 1
    balls = balls.copy()
    if symmetry & 1:
        rgb, balls[:, 0], balls[:, 3] = rgb[:, ::-1], last - balls[:, 0], -balls[:, 3]
    if symmetry & 2:
        rgb, balls[:, 1], balls[:, 4] = rgb[::-1], last - balls[:, 1], -balls[:, 4]
    if symmetry & 4:
        rgb, balls = rgb.transpose(1, 0, 2), balls[:, [1, 0, 2, 4, 3, 5, 6]]
    return np.ascontiguousarray(rgb), balls


def _zoom_randomly(rng: np.random.Generator, rgb: ByteArray, balls: Float32Array) -> tuple[ByteArray, Float32Array]:
    side = rgb.shape[0]
    typical = float(np.nanmedian(balls[:, 2])) if np.isfinite(balls[:, 2]).any() else 7.0
    low, high = np.clip([RADIUS_LIMITS_PX[0] / typical, RADIUS_LIMITS_PX[1] / typical], *ZOOM_LIMITS)
    zoom, angle = float(rng.uniform(low, high)), float(rng.uniform(0, 2 * np.pi))
    linear = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return apply_similarity(
        rgb, balls, linear, rng.uniform(0.3, 0.7, 2) * side, [int(c) for c in rng.integers(0, 256, 3)]
    )


def apply_similarity(
    rgb: ByteArray, balls: Float32Array, linear: FloatArray, middle: FloatArray, border: list[int]
) -> tuple[ByteArray, Float32Array]:
    """Map an image and its balls by a similarity (2, 2) that moves the point `middle` (2,) px to the middle."""
    side = rgb.shape[0]
    matrix = np.column_stack([linear, (side - 1) / 2 - linear @ middle])
    moved = cv2.warpAffine(rgb, matrix, (side, side), flags=cv2.INTER_LINEAR, borderValue=border)
    balls = balls.copy()
    balls[:, :2] = balls[:, :2] @ linear.T + matrix[:, 2]
    balls[:, 3:5] = balls[:, 3:5] @ linear.T
    balls[:, 2] *= np.sqrt(np.linalg.det(linear))
    outside = ((balls[:, :2] < 0) | (balls[:, :2] > side - 1)).any(axis=1)
    balls[outside, VISIBLE_COLUMN] = 0
    return np.asarray(moved, dtype=np.uint8), balls


def _change_light(rng: np.random.Generator, rgb: ByteArray) -> ByteArray:
    levels = np.linspace(0, 1, 256) ** rng.uniform(0.75, 1.33)
    gain = np.exp(rng.normal(0, 0.12) + rng.normal(0, 0.06, 3))
    tones = np.clip(255 * (levels[:, None] * gain + rng.normal(0, 0.02)), 0, 255).astype(np.uint8)
    lit = cv2.LUT(rgb, tones[None])
    noise = rng.normal(0, rng.uniform(0, 6), (*rgb.shape[:2], 1)) if rng.random() < 0.3 else 0.0
    return np.asarray(np.clip(lit + noise, 0, 255), dtype=np.uint8)


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
