"""Detections projected onto the table, in metres and seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import FloatArray, IntArray

# A ball's centre is at least one radius inside the noses; the calibration may be wrong by this much more.
OFF_TABLE_RADII = 1.0
# A centre this near to a pocket's centre may be outside the noses: the ball is falling.
_POCKET_RADII = 2.2
# Following frames, and standard deviations, that decide whether a ball rests.
_STILL_FRAMES, _SAME_PLACE_SIGMAS = 6, 3.0
# Least detection error, px: compression moves small balls about.
_MIN_SIGMA_PX = 0.25


@dataclass(frozen=True, slots=True)
class TableDetections:
    """K detections in columns; `first[k]:first[k + 1]` are those of frame k."""

    row: IntArray
    """(K,) row in `Detections`."""
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
    """(K, 2, 2) d(m)/d(px) over `scale`: an oblique view stretches a circle of errors."""
    is_still: NDArray[np.bool_]
    """(K,) detected again at the same place in most of the next frames."""
    cloth: FloatArray
    """(3,) L*a*b*."""


def project_detections(detections: Detections, frame: IntArray, scene: Scene) -> TableDetections:
    """Project the detections of the frames `frame` (T,) onto the table; drop those that cannot be balls."""
    frame_index = np.searchsorted(frame, detections.frame)
    is_in_frames = (frame_index < len(frame)) & (frame[np.minimum(frame_index, len(frame) - 1)] == detections.frame)
    row = np.flatnonzero(is_in_frames)
    radius = scene.table.ball_radius
    px = detections.centre[row]
    xy = scene.camera.to_table(px, radius, detections.frame[row])
    inside = _can_be_ball(xy, scene) & np.isfinite(xy).all(axis=1)
    row, xy, px, frame_index = row[inside], xy[inside], px[inside], frame_index[row][inside]
    jacobian = scene.camera.metres_per_pixel(xy, radius)
    # root mean square over the directions in the image, since an oblique view has no single scale
    scale = np.sqrt((jacobian**2).sum(axis=(1, 2)) / 2)
    ends = scene.camera.to_table(px + detections.streak[row], radius, detections.frame[row])
    sigma = np.hypot(detections.sigma[row], _MIN_SIGMA_PX) * scale
    along = np.hypot(detections.sigma_along[row], _MIN_SIGMA_PX) * scale
    first = np.searchsorted(frame_index, np.arange(len(frame) + 1))
    is_still = _find_still(first, xy, sigma)
    colour, score = detections.colour[row], detections.score[row]
    return TableDetections(
        row, first, xy, sigma, np.maximum(along, sigma), ends - xy, colour, score, scale,
        jacobian / scale[:, None, None], is_still, scene.cloth_lab,
    )  # fmt: skip


def _find_still(first: IntArray, xy: FloatArray, sigma: FloatArray) -> NDArray[np.bool_]:
    """Mark the detections (K,) that recur within their noise in most of the next `_STILL_FRAMES` frames."""
    is_still = np.zeros(len(xy), bool)
    for k in range(len(first) - 1 - _STILL_FRAMES):
        now = slice(first[k], first[k + 1])
        recurrences = np.zeros(first[k + 1] - first[k], np.int64)
        for later in range(k + 1, k + 1 + _STILL_FRAMES):
            then = slice(first[later], first[later + 1])
            gap = np.hypot(*np.moveaxis(xy[now, None] - xy[None, then], 2, 0))
            recurrences += (gap < _SAME_PLACE_SIGMAS * np.hypot(sigma[now, None], sigma[None, then])).any(axis=1)
        is_still[now] = recurrences >= _STILL_FRAMES - 2
    return is_still


def _can_be_ball(xy: FloatArray, scene: Scene) -> NDArray[np.bool_]:
    """Mark the places (K, 2) that a ball's centre can have."""
    table, r = scene.table, scene.table.ball_radius
    margin = (1.0 - OFF_TABLE_RADII) * r
    is_inside = (xy >= margin).all(axis=1) & (xy[:, 0] <= table.length - margin) & (xy[:, 1] <= table.width - margin)
    if not table.pockets:
        return np.asarray(is_inside)
    is_near_pocket = (
        np.hypot(*np.moveaxis(xy[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1) < _POCKET_RADII * r
    )
    return np.asarray(is_inside | is_near_pocket)
