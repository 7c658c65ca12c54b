"""Balls at rest to measure, shown as they were found: a little off, in many sizes; and the truth beside each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detectors.network.disc_crop import SIDE, Upright
from detectors.training.data.distractors import littered
from detectors.training.data.training_shards import Pictures
from models.core.typing import ByteArray, Float32Array, FloatArray

LEAST_VISIBLE, LEAST_RADIUS_PX, MOST_MOVED_RADII = 0.35, 3.3, 0.6
"""Of a ball that is measured: share that nothing hides, size, and way during the exposure."""
SIZE_ERROR = 0.03
"""How far off its size is shown, one standard deviation of the logarithm: errors of the calibration."""
NEAR_SHARE, NEAR_RADII, FAR_RADII = 0.7, 0.1, 0.5
"""Share of balls that are shown about so far off per axis, one standard deviation; others lie anywhere within this."""
LEVEL_SHARE, LEVEL_RAD = 0.8, 0.15
"""Share of cameras that stand level but for so much, one standard deviation; the rest are turned by any angle."""
LITTERED_SHARE = 0.2
"""Share of the pictures with litter beneath the balls."""


@dataclass(frozen=True, slots=True)
class DiscPictures:
    """K balls as they are shown."""

    shown: ByteArray
    """(K, SIDE, SIDE, 3)"""
    told: Float32Array
    """(K, 2) as in `Upright.told`, ball radii."""
    radius: Float32Array
    """(K,) px in the picture."""
    visible: Float32Array
    """(K,) share of the disc that nothing hides."""

    def __len__(self) -> int:
        return len(self.shown)


@dataclass(frozen=True, slots=True)
class Discs:
    """The balls of some pictures that can be measured."""

    pictures: Pictures
    rows: NDArray[np.int64]
    """(K, 2) picture and ball."""

    def __len__(self) -> int:
        return len(self.rows)


def discs_in(pictures: Pictures) -> Discs:
    """Those at rest that are in a picture, large enough and not hidden."""
    place, radius = pictures.balls[..., :2], pictures.balls[..., 2]
    still = np.linalg.norm(pictures.balls[..., 3:5], axis=-1) < MOST_MOVED_RADII * radius
    seen = (pictures.balls[..., 6] > LEAST_VISIBLE) & (radius > LEAST_RADIUS_PX)
    inside = ((place > 0) & (place < pictures.rgb.shape[1] - 1)).all(axis=-1)
    return Discs(pictures, np.argwhere(still & seen & inside))


def with_litter(rng: np.random.Generator, pictures: Pictures) -> Pictures:
    """The same with litter on the cloth of some."""
    rgb = pictures.rgb.copy()
    for k in np.flatnonzero(rng.random(len(rgb)) < LITTERED_SHARE):
        rgb[k] = littered(rng, rgb[k], pictures.balls[k])
    return Pictures(rgb, pictures.balls)


def shown_balls(rng: np.random.Generator, given: list[tuple[Discs, int]]) -> DiscPictures:
    """Balls, by their discs and row there, each as a draw has it found."""
    columns = [_shown(rng, discs, row) for discs, row in given]
    shown = np.array([column[0] for column in columns], dtype=np.uint8).reshape(-1, SIDE, SIDE, 3)
    told, radius, visible = (np.array([column[k] for column in columns], dtype=np.float32) for k in (1, 2, 3))
    return DiscPictures(shown, told.reshape(-1, 2), radius, visible)


def _shown(rng: np.random.Generator, discs: Discs, row: int) -> tuple[ByteArray, FloatArray, float, float]:
    """Picture, what is told of it, radius and visible share of one ball."""
    picture, ball = discs.rows[row]
    x, y, radius, *_, visible = discs.pictures.balls[picture, ball].astype(np.float64)
    near, angle = rng.random() < NEAR_SHARE, rng.uniform(0, 2 * np.pi)
    off = rng.normal(0, NEAR_RADII, 2) if near else FAR_RADII * np.sqrt(rng.random()) * _unit(angle)
    turn = rng.normal(0, LEVEL_RAD) if rng.random() < LEVEL_SHARE else rng.uniform(0, 2 * np.pi)
    centre = np.array([x, y])
    at = Upright(centre + radius * off, radius * float(np.exp(rng.normal(0, SIZE_ERROR))), float(turn))
    return at.picture(discs.pictures.rgb[picture]), at.told(centre), radius, visible


def _unit(angle: float) -> FloatArray:
    return np.array([np.cos(angle), np.sin(angle)])
