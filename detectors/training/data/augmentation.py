"""Augmentation of training images: symmetries, rotation, scale, light, distractors, noise."""

from __future__ import annotations

import cv2
import numpy as np

from detectors.training.data.distractors import paint_distractors
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
