"""One training picture in many forms: turned, mirrored, nearer or farther, in another light, with litter or noise."""

from __future__ import annotations

import cv2
import numpy as np

from detectors.training.data.distractors import littered
from models.core.typing import ByteArray, Float32Array, FloatArray

TURNED_SHARE, LITTERED_SHARE, RELIT_SHARE = 0.5, 0.4, 0.7
"""Share of pictures turned by any angle and scaled, of those with litter on the cloth, and in another light."""
ZOOM = (0.75, 1.35)
RADII_PX = (3.5, 13.0)
"""Balls are kept within the sizes that the network is made for."""
VISIBLE = 6
"""Column of `training_data.COLUMNS`."""


def vary(rng: np.random.Generator, rgb: ByteArray, balls: Float32Array) -> tuple[ByteArray, Float32Array]:
    """A picture (S, S, 3) and its balls (N, 7) in a form drawn at random."""
    rgb, balls = turned(rgb, balls, int(rng.integers(8)))
    if rng.random() < TURNED_SHARE:
        rgb, balls = _zoomed(rng, rgb, balls)
    if rng.random() < LITTERED_SHARE:
        rgb = littered(rng, rgb, balls)
    if rng.random() < RELIT_SHARE:
        rgb = _relit(rng, rgb)
    return rgb, balls


def turned(rgb: ByteArray, balls: Float32Array, way: int) -> tuple[ByteArray, Float32Array]:
    """A picture (S, S, 3) and its balls (N, 7) in one of the eight positions of a square."""
    last = rgb.shape[0] - 1
    balls = balls.copy()
    if way & 1:
        rgb, balls[:, 0], balls[:, 3] = rgb[:, ::-1], last - balls[:, 0], -balls[:, 3]
    if way & 2:
        rgb, balls[:, 1], balls[:, 4] = rgb[::-1], last - balls[:, 1], -balls[:, 4]
    if way & 4:
        rgb, balls = rgb.transpose(1, 0, 2), balls[:, [1, 0, 2, 4, 3, 5, 6]]
    return np.ascontiguousarray(rgb), balls


def _zoomed(rng: np.random.Generator, rgb: ByteArray, balls: Float32Array) -> tuple[ByteArray, Float32Array]:
    side = rgb.shape[0]
    typical = float(np.nanmedian(balls[:, 2])) if np.isfinite(balls[:, 2]).any() else 7.0
    low, high = np.clip([RADII_PX[0] / typical, RADII_PX[1] / typical], *ZOOM)
    zoom, angle = float(rng.uniform(low, high)), float(rng.uniform(0, 2 * np.pi))
    linear = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return placed(rgb, balls, linear, rng.uniform(0.3, 0.7, 2) * side, [int(c) for c in rng.integers(0, 256, 3)])


def placed(
    rgb: ByteArray, balls: Float32Array, linear: FloatArray, middle: FloatArray, border: list[int]
) -> tuple[ByteArray, Float32Array]:
    """A picture mapped by a similarity (2, 2) that takes the point `middle` (2,) px to the middle of the new one."""
    side = rgb.shape[0]
    matrix = np.column_stack([linear, (side - 1) / 2 - linear @ middle])
    moved = cv2.warpAffine(rgb, matrix, (side, side), flags=cv2.INTER_LINEAR, borderValue=border)
    balls = balls.copy()
    balls[:, :2] = balls[:, :2] @ linear.T + matrix[:, 2]
    balls[:, 3:5] = balls[:, 3:5] @ linear.T
    balls[:, 2] *= np.sqrt(np.linalg.det(linear))
    outside = ((balls[:, :2] < 0) | (balls[:, :2] > side - 1)).any(axis=1)
    balls[outside, VISIBLE] = 0
    return np.asarray(moved, dtype=np.uint8), balls


def _relit(rng: np.random.Generator, rgb: ByteArray) -> ByteArray:
    levels = np.linspace(0, 1, 256) ** rng.uniform(0.75, 1.33)
    gain = np.exp(rng.normal(0, 0.12) + rng.normal(0, 0.06, 3))
    tones = np.clip(255 * (levels[:, None] * gain + rng.normal(0, 0.02)), 0, 255).astype(np.uint8)
    lit = cv2.LUT(rgb, tones[None])
    noise = rng.normal(0, rng.uniform(0, 6), (*rgb.shape[:2], 1)) if rng.random() < 0.3 else 0.0
    return np.asarray(np.clip(lit + noise, 0, 255), dtype=np.uint8)
