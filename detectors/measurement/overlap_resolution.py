"""Balls are solid: no two are nearer than touching, which tells more of where they are than each by itself.

In a rack every ball hides part of others' outlines, and what is measured of one errs by a quarter of its size. Where
two would stand in one another, both are moved apart, each as far as its error allows; only where no error explains it
is one of them none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.measurement.frame_detections import APART_RADII, APART_SEEN_RADII, Found, best_first
from models.core.scene import Scene
from models.core.typing import BoolArray, FloatArray

TOUCHING_SHARE = 0.02
"""How far the distance of two touching balls may be from two radii, share of it, one standard deviation: errors of the
table's and of the balls' size."""
MOST_SIGMAS = 5.0
"""Standard deviations of their distance by which two balls may seem to stand in one another."""
TURNS = 4
"""How often balls are moved: which ways depends on where they are."""


def stood_apart(found: Found, scene: Scene, frame: int) -> Found:
    """The best ones of balls, px of a frame, that can stand beside each other, moved so that no two overlap."""
    if len(found.score) < 2:
        return found
    xy = scene.camera.to_table(found.centre, scene.table.ball_radius, frame)
    seen = _distances(found.centre)[0] > APART_SEEN_RADII * found.radius[:, None]
    if seen.all() and (_distances(xy)[0] > 2 * scene.table.ball_radius).all():
        return found.take(best_first(found, seen))
    ground = _Ground.beneath(found, scene, frame)
    rows = best_first(found, ground.possible() & seen)
    return replace(found.take(rows), centre=found.centre[rows] + ground.take(rows).shifts())


@dataclass(frozen=True, slots=True)
class _Ground:
    """Where N balls are on the table."""

    xy: FloatArray
    """(N, 2) m."""
    jacobian: FloatArray
    """(N, 2, 2) m/px."""
    covariance: FloatArray
    """(N, 2, 2) m^2."""
    radius: float
    """m."""

    @staticmethod
    def beneath(found: Found, scene: Scene, frame: int) -> _Ground:
        """Balls seen in a frame."""
        radius, camera = scene.table.ball_radius, scene.camera
        xy = camera.to_table(found.centre, radius, frame)
        steps = [camera.to_table(found.centre + step, radius, frame) - xy for step in np.eye(2)]
        jacobian = np.stack(steps, axis=-1)
        length = np.linalg.norm(found.streak, axis=1)
        along = found.streak / np.maximum(length, 1e-12)[:, None]
        alike = found.sigma[:, None, None] ** 2 * np.eye(2)
        longer = (found.sigma_along**2 - found.sigma**2)[:, None, None] * along[:, :, None] * along[:, None]
        covariance = jacobian @ (alike + longer) @ jacobian.transpose(0, 2, 1)
        return _Ground(xy, jacobian, covariance, radius)

    def take(self, rows: NDArray[np.int64]) -> _Ground:
        """Some of the balls."""
        return _Ground(self.xy[rows], self.jacobian[rows], self.covariance[rows], self.radius)

    def possible(self) -> BoolArray:
        """Which pairs (N, N) can both be there."""
        apart, way = _distances(self.xy)
        either = self.covariance[:, None] + self.covariance[None]
        variance = np.einsum("nmi,nmij,nmj->nm", way, either, way) + self._play() ** 2
        explained = 2 * self.radius - apart < MOST_SIGMAS * np.sqrt(variance)
        return np.asarray(explained | (apart > APART_RADII * self.radius))

    def shifts(self) -> FloatArray:
        """Px (N, 2) by which balls that stand in one another are to be moved.

        The most likely places of all balls at once, given that those that overlap touch: linear least squares with
        equality constraints, whose multipliers only push.
        """
        n = len(self.xy)
        moved = self.xy
        pairs = np.empty((0, 2), dtype=np.int64)
        for _ in range(TURNS):
            apart, way = _distances(moved)
            inside = np.triu(apart < 2 * self.radius, 1)
            pairs = np.unique(np.concatenate([pairs, np.argwhere(inside)]), axis=0)
            if not len(pairs):
                return np.zeros((n, 2))
            first, second = pairs.T
            push = np.zeros((len(pairs), n, 2))
            each = np.arange(len(pairs))
            push[each, first], push[each, second] = way[first, second], -way[first, second]
            wanted = 2 * self.radius - np.einsum("pni,ni->p", push, self.xy)
            spread = np.einsum("pni,nij->pnj", push, self.covariance)
            normal = np.einsum("pni,qni->pq", spread, push) + self._play() ** 2 * np.eye(len(pairs))
            force = np.linalg.solve(normal, wanted)
            pairs = pairs[force > 0]
            moved = self.xy + np.einsum("p,pni->ni", np.maximum(force, 0.0), spread)
        return np.asarray(np.linalg.solve(self.jacobian, (moved - self.xy)[..., None])[..., 0])

    def _play(self) -> float:
        return 2 * self.radius * TOUCHING_SHARE


def _distances(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Between places (N, 2): lengths (N, N), infinite of a place to itself, and unit vectors (N, N, 2) to the first."""
    off = places[:, None] - places[None]
    apart = np.linalg.norm(off, axis=-1)
    np.fill_diagonal(apart, np.inf)
    return apart, off / np.maximum(apart, 1e-12)[..., None]
