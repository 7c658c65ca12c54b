"""Balls found in one picture, and what of them cannot stand beside each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Scene
from models.core.typing import BoolArray, FloatArray

APART_RADII = 1.75
"""Two balls are at least two radii apart on the table; less than this, with the errors, and one of them is none."""
APART_SEEN_RADII = 0.9
"""The same in the picture, where one ball may hide part of another."""


@dataclass(frozen=True, slots=True)
class Found:
    """Balls in one picture, columns as in `Detections`, px of that picture."""

    centre: FloatArray
    radius: FloatArray
    streak: FloatArray
    score: FloatArray
    sigma: FloatArray
    sigma_along: FloatArray

    def take(self, rows: NDArray[np.int64] | BoolArray) -> Found:
        """Some of the rows."""
        return Found(*(getattr(self, name)[rows] for name in self.__slots__))


NO_BALLS = Found(np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))


def joined(discs: Found, streaks: Found) -> Found:
    """Discs outside the streaks, and the streaks first."""
    return chained(streaks, discs.take(~np.asarray(inside(discs.centre, streaks).any(axis=0))))


def chained(first: Found, second: Found) -> Found:
    return Found(*(np.concatenate([getattr(first, n), getattr(second, n)]) for n in Found.__slots__))


def inside(points: FloatArray, streaks: Found) -> BoolArray:
    """Whether points (n, 2) lie in streaks: (K, n)."""
    length = np.maximum(np.linalg.norm(streaks.streak, axis=1), 1e-9)
    unit = streaks.streak / length[:, None]
    at = points[None] - streaks.centre[:, None]
    along = np.clip(np.einsum("kni,ki->kn", at, unit), -length[:, None] / 2, length[:, None] / 2)
    beside = np.linalg.norm(at - along[..., None] * unit[:, None], axis=-1)
    return np.asarray(beside < streaks.radius[:, None])


def without_overlaps(found: Found, scene: Scene, frame: int) -> Found:
    """The best ones of rivals: of those that cannot stand beside each other."""
    radius = scene.table.ball_radius
    xy = scene.camera.to_table(found.centre, radius, frame)
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1) > APART_RADII * radius
    seen = np.linalg.norm(found.centre[:, None] - found.centre[None], axis=-1)
    apart &= seen > APART_SEEN_RADII * found.radius[:, None]
    return found.take(best_first(found, apart))


def best_first(found: Found, possible: BoolArray) -> NDArray[np.int64]:
    """Rows of balls, streaks and what is likelier first, of which `possible` (N, N) says that each two can be."""
    kept: list[int] = []
    streaked = np.linalg.norm(found.streak, axis=1) > 0
    for row in np.lexsort((-found.score, ~streaked)).tolist():
        if possible[row, kept].all():
            kept.append(row)
    return np.array(kept, dtype=np.int64)
