"""Overlap resolution: balls are solid, so measured positions that overlap on the table are moved apart.

In a rack every ball hides part of the others' outlines, and a single measurement may be off by a quarter of the ball's
size. Where two balls would overlap, both are moved, each in proportion to its variance; only where no error explains
the overlap one of them is removed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.measurement.frame_detections import (
    MIN_IMAGE_DISTANCE_RADII,
    MIN_TABLE_DISTANCE_RADII,
    FrameDetections,
    select_compatible,
)
from models.core.scene import Scene
from models.core.typing import BoolArray, FloatArray

# Standard deviation of the distance of two touching balls, share of two radii: errors of the sizes of table and balls.
CONTACT_SIGMA_SHARE = 0.02
# Standard deviations of their distance by which two balls may seem to overlap.
MAX_SIGMAS = 5.0
# Iterations of the shifts: their directions depend on the positions.
ITERATIONS = 4


def resolve_overlaps(detections: FrameDetections, scene: Scene, frame: int) -> FrameDetections:
    """Select compatible balls, the best first, and move them so that no two overlap.

    Args:
        detections: N balls, px of the frame.
        scene: Table and camera.
        frame: Number of the frame.

    Returns:
        The remaining balls with their moved centres.
    """
    if len(detections.score) < 2:
        return detections
    xy = scene.camera.to_table(detections.centre, scene.table.ball_radius, frame)
    is_apart_in_image = _pairwise_offsets(detections.centre)[0] > MIN_IMAGE_DISTANCE_RADII * detections.radius[:, None]
    if is_apart_in_image.all() and (_pairwise_offsets(xy)[0] > 2 * scene.table.ball_radius).all():
        return detections.take(select_compatible(detections, is_apart_in_image))
    positions = _TablePositions.project_detections(detections, scene, frame)
    rows = select_compatible(detections, positions.is_compatible() & is_apart_in_image)
    return replace(detections.take(rows), centre=detections.centre[rows] + positions.take(rows).compute_shifts())


@dataclass(frozen=True, slots=True)
class _TablePositions:
    """Positions of N balls on the table."""

    xy: FloatArray
    """(N, 2) m."""
    jacobian: FloatArray
    """(N, 2, 2) m/px."""
    covariance: FloatArray
    """(N, 2, 2) m^2."""
    radius: float
    """m."""

    @staticmethod
    def project_detections(detections: FrameDetections, scene: Scene, frame: int) -> _TablePositions:
        """Project balls of a frame to the table."""
        radius, camera = scene.table.ball_radius, scene.camera
        xy = camera.to_table(detections.centre, radius, frame)
        steps = [camera.to_table(detections.centre + step, radius, frame) - xy for step in np.eye(2)]
        jacobian = np.stack(steps, axis=-1)
        length = np.linalg.norm(detections.streak, axis=1)
        along = detections.streak / np.maximum(length, 1e-12)[:, None]
        alike = detections.sigma[:, None, None] ** 2 * np.eye(2)
        longer = (detections.sigma_along**2 - detections.sigma**2)[:, None, None] * along[:, :, None] * along[:, None]
        covariance = jacobian @ (alike + longer) @ jacobian.transpose(0, 2, 1)
        return _TablePositions(xy, jacobian, covariance, radius)

    def take(self, rows: NDArray[np.int64]) -> _TablePositions:
        """Select rows."""
        return _TablePositions(self.xy[rows], self.jacobian[rows], self.covariance[rows], self.radius)

    def is_compatible(self) -> BoolArray:
        """Which pairs (N, N) of balls can both be there."""
        apart, way = _pairwise_offsets(self.xy)
        either = self.covariance[:, None] + self.covariance[None]
        variance = np.einsum("nmi,nmij,nmj->nm", way, either, way) + self._contact_sigma() ** 2
        explained = 2 * self.radius - apart < MAX_SIGMAS * np.sqrt(variance)
        return np.asarray(explained | (apart > MIN_TABLE_DISTANCE_RADII * self.radius))

    def compute_shifts(self) -> FloatArray:
        """Compute the shifts (N, 2), px, of balls that overlap.

        The most likely positions of all balls together, under the constraint that those that overlap touch: linear
        least squares with equality constraints whose multipliers are positive (balls only push each other).
        """
        n = len(self.xy)
        moved = self.xy
        pairs = np.empty((0, 2), dtype=np.int64)
        for _ in range(ITERATIONS):
            apart, way = _pairwise_offsets(moved)
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
            normal = np.einsum("pni,qni->pq", spread, push) + self._contact_sigma() ** 2 * np.eye(len(pairs))
            force = np.linalg.solve(normal, wanted)
            pairs = pairs[force > 0]
            moved = self.xy + np.einsum("p,pni->ni", np.maximum(force, 0.0), spread)
        return np.asarray(np.linalg.solve(self.jacobian, (moved - self.xy)[..., None])[..., 0])

    def _contact_sigma(self) -> float:
        return 2 * self.radius * CONTACT_SIGMA_SHARE


def _pairwise_offsets(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (N, N) of places (N, 2), infinite on the diagonal, and unit vectors (N, N, 2) to the first."""
    off = places[:, None] - places[None]
    apart = np.linalg.norm(off, axis=-1)
    np.fill_diagonal(apart, np.inf)
    return apart, off / np.maximum(apart, 1e-12)[..., None]
