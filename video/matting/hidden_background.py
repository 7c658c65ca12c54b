"""What moving balls hide, learnt from the whole clip."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import BoolArray, FloatArray, ImageArray
from video.matting.background_plate import SHADED, UNDER, Plate, learn_plate
from video.matting.ball_matting import SHADOW_RADII, Outline
from video.matting.ball_timeline import Sightings
from video.matting.frame_store import Gallery

MOST_SAMPLES, FEWEST_SAMPLES = 32, 13
"""Pictures, spread over the clip, that the plate is learnt from."""
PLATE_BYTES = 64_000_000
"""Memory for the swept pixels of those pictures; larger areas are learnt from fewer."""
AFTER_STRIKE_S, AFTER_STRIKE_ROWS = 0.5, 6
"""s after the first motion in which more pictures are looked at, and how many of them."""
UNDER_RADII = 1.2
"""Radii around a ball's place that it may hide; beyond, it only shades."""


def plate_of(sightings: Sightings, gallery: Gallery) -> Plate:
    """Learn what moving balls hide from pictures spread evenly over the clip."""
    swept = swept_by(sightings)
    count = int(np.clip(PLATE_BYTES // (4 * max(1, int(swept.sum()))), FEWEST_SAMPLES, MOST_SAMPLES))
    rows = _rows_to_learn(sightings, count)
    return learn_plate(swept, (_sample(sightings, row, rgb) for row, rgb in gallery.at(rows.tolist())))


def _rows_to_learn(sightings: Sightings, count: int) -> NDArray[np.int64]:
    """Rows spread evenly over the clip, and some just after the strike: a cue may come to rest where the ball lay."""
    spread = np.linspace(0, len(sightings.t) - 1, count)
    moving = np.flatnonzero(sightings.moves.any(axis=1))
    if len(moving):
        begins = sightings.t[moving[0]] + np.linspace(0, AFTER_STRIKE_S, AFTER_STRIKE_ROWS)
        spread = np.concatenate([spread, np.interp(begins, sightings.t, np.arange(len(sightings.t)))])
    return np.unique(spread.round().astype(np.int64))


def swept_by(sightings: Sightings) -> BoolArray:
    """(H, W) reference pixels that a moving ball with its surroundings ever touches."""
    camera = sightings.scene.camera
    swept = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    for row in np.flatnonzero(sightings.moves.any(axis=1)):
        for ball in sightings.taken_out(int(row)):
            for side in (int(row), int(row) + 1):
                if np.isfinite(sightings.centre[side, ball]).all():
                    _stamp(swept, sightings.outline(side, ball), sightings.motion(float(sightings.t[side])))
    return swept > 0


def _stamp(mask: ImageArray, outline: Outline, motion: FloatArray | None) -> None:
    """Mark in reference pixels all that a ball can touch."""
    back = np.eye(3) if motion is None else np.linalg.inv(motion)
    way = apply_homography(np.asarray(back, dtype=np.float64), outline.way)
    thickness = int(np.ceil(2 * outline.reach)) + 8
    points = np.rint(np.concatenate([way, way[-1:]])).astype(np.int32)
    cv2.polylines(mask, [points.reshape(-1, 1, 2)], isClosed=False, color=255, thickness=thickness)
    cv2.circle(mask, points[0].tolist(), thickness // 2, 255, -1)


def _sample(sightings: Sightings, row: int, picture: ImageArray) -> tuple[ImageArray, ImageArray, FloatArray | None]:
    """A picture, what of it (H, W) balls cover or shade, and its motion."""
    covered = np.zeros(picture.shape[:2], dtype=np.uint8)
    known = np.flatnonzero(np.isfinite(sightings.centre[row, :, 0]))
    outlines = [sightings.outline(row, int(ball)) for ball in known]
    for level, radii in ((SHADED, SHADOW_RADII), (UNDER, UNDER_RADII)):
        for outline in outlines:
            radius = int(np.ceil(radii * outline.radius + outline.edge))
            for point in np.rint(outline.way).astype(int):
                cv2.circle(covered, point.tolist(), radius, level, -1)
    return picture, covered, sightings.motion(float(sightings.t[row]))
