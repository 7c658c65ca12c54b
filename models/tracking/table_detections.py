"""Detections on the table: the columns that association works with, in metres and seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import FloatArray, IntArray

OFF_TABLE_RADII = 1.0
"""A ball's centre is at least one radius inside the noses; this much further out may be an error of the calibration."""
_POCKET_RADII = 2.2
"""A centre this near to a pocket's centre may lie outside the noses: the ball is falling."""
_NEXT, _SAME_PLACE = 6, 3.0
"""Pictures looked ahead, and standard deviations, to tell a ball at rest."""
_LEAST_SIGMA_PX = 0.25
"""Association trusts no detector further than this: compression moves small balls about."""


@dataclass(frozen=True, slots=True)
class Sightings:
    """K detections in columns; `first[k]:first[k + 1]` are those of picture k."""

    row: IntArray
    """(K,) row in the `Detections` they came from."""
    first: IntArray
    """(T + 1,)"""
    xy: FloatArray
    """(K, 2) m."""
    sigma: FloatArray
    """(K,) m, across the streak."""
    sigma_along: FloatArray
    """(K,) m, along it."""
    streak: FloatArray
    """(K, 2) m travelled during the exposure, sign unknown."""
    colour: FloatArray
    """(K, 3) L*a*b*."""
    score: FloatArray
    """(K,) in [0, 1]."""
    scale: FloatArray
    """(K,) m/px."""
    lay: FloatArray
    """(K, 2, 2) d(m)/d(px) over `scale`: how an oblique view stretches a circle of errors."""
    still: NDArray[np.bool_]
    """(K,) seen again in the same place in most of the next pictures."""
    cloth: FloatArray
    """(3,) L*a*b*."""


def sight(detections: Detections, frame: IntArray, scene: Scene) -> Sightings:
    """Put the detections of the pictures `frame` (T,) on the table; those that cannot be balls stay out."""
    picture = np.searchsorted(frame, detections.frame)
    known = (picture < len(frame)) & (frame[np.minimum(picture, len(frame) - 1)] == detections.frame)
    row = np.flatnonzero(known)
    radius = scene.table.ball_radius
    px = detections.centre[row]
    xy = scene.camera.to_table(px, radius, detections.frame[row])
    inside = _may_be_ball(xy, scene) & np.isfinite(xy).all(axis=1)
    row, xy, px, picture = row[inside], xy[inside], px[inside], picture[row][inside]
    jacobian = scene.camera.metres_per_pixel(xy, radius)
    # root mean square over the directions of the picture: one number where a view is oblique
    scale = np.sqrt((jacobian**2).sum(axis=(1, 2)) / 2)
    ends = scene.camera.to_table(px + detections.streak[row], radius, detections.frame[row])
    sigma = np.hypot(detections.sigma[row], _LEAST_SIGMA_PX) * scale
    along = np.hypot(detections.sigma_along[row], _LEAST_SIGMA_PX) * scale
    first = np.searchsorted(picture, np.arange(len(frame) + 1))
    still = _still(first, xy, sigma)
    colour, score = detections.colour[row], detections.score[row]
    return Sightings(
        row, first, xy, sigma, np.maximum(along, sigma), ends - xy, colour, score, scale,
        jacobian / scale[:, None, None], still, scene.cloth_lab,
    )  # fmt: skip


def _still(first: IntArray, xy: FloatArray, sigma: FloatArray) -> NDArray[np.bool_]:
    """Which sightings (K,) recur within their noise in most of the next `_NEXT` pictures."""
    still = np.zeros(len(xy), bool)
    for k in range(len(first) - 1 - _NEXT):
        now = slice(first[k], first[k + 1])
        again = np.zeros(first[k + 1] - first[k], np.int64)
        for later in range(k + 1, k + 1 + _NEXT):
            then = slice(first[later], first[later + 1])
            gap = np.hypot(*np.moveaxis(xy[now, None] - xy[None, then], 2, 0))
            again += (gap < _SAME_PLACE * np.hypot(sigma[now, None], sigma[None, then])).any(axis=1)
        still[now] = again >= _NEXT - 2
    return still


def _may_be_ball(xy: FloatArray, scene: Scene) -> NDArray[np.bool_]:
    """Which places (K, 2) a ball's centre can be at."""
    table, r = scene.table, scene.table.ball_radius
    margin = (1.0 - OFF_TABLE_RADII) * r
    inside = (xy >= margin).all(axis=1) & (xy[:, 0] <= table.length - margin) & (xy[:, 1] <= table.width - margin)
    if not table.pockets:
        return np.asarray(inside)
    near = np.hypot(*np.moveaxis(xy[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1) < _POCKET_RADII * r
    return np.asarray(inside | near)
