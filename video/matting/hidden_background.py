"""Estimation of the background that moving balls hide, from the whole clip."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import apply_homography
from models.core.typing import BoolArray, FloatArray, ImageArray
from video.io.clip import Clip
from video.matting.background_plate import (
    COVERED_BY_BALL,
    COVERED_BY_SHADOW,
    BackgroundPlate,
    estimate_background_plate,
)
from video.matting.ball_matting import SHADOW_RADII, BallOutline
from video.matting.ball_timeline import BallTimeline, read_rows

# Largest and smallest number of frames, spread over the clip, that the plate is estimated from.
MAX_SAMPLES, MIN_SAMPLES = 32, 13
# Memory for the needed pixels of those frames; larger areas use fewer frames.
MAX_PLATE_BYTES = 64_000_000
# s after the first motion in which further frames are used, and their number.
AFTER_STRIKE_S, AFTER_STRIKE_ROWS = 0.5, 6
# Radii around a ball's position that it may hide; beyond, it only casts shadow.
HIDDEN_RADII = 1.2


@dataclass(frozen=True, slots=True)
class HiddenBackground:
    """The positions of the balls of a clip, and the background that the moving ones hide."""

    timeline: BallTimeline
    plate: BackgroundPlate
    """Valid wherever a moving ball is."""


def estimate_hidden_background(timeline: BallTimeline, clip: Clip) -> HiddenBackground:
    """Estimate the background behind the moving balls from frames spread evenly over the clip.

    Args:
        timeline: Positions of the balls.

    Returns:
        The timeline and the background plate.
    """
    region = find_covered_region(timeline)
    count = int(np.clip(MAX_PLATE_BYTES // (4 * max(1, int(region.sum()))), MIN_SAMPLES, MAX_SAMPLES))
    rows = _select_sample_rows(timeline, count)
    samples = (_build_sample(timeline, row, rgb) for row, rgb in read_rows(clip, timeline, rows.tolist()))
    return HiddenBackground(timeline, estimate_background_plate(region, samples))


def _select_sample_rows(timeline: BallTimeline, count: int) -> NDArray[np.int64]:
    """Select rows spread evenly over the clip, and some just after the strike.

    A cue may come to rest where the ball was.
    """
    spread = np.linspace(0, len(timeline.t) - 1, count)
    moving = np.flatnonzero(timeline.moving.any(axis=1))
    if len(moving):
        begins = timeline.t[moving[0]] + np.linspace(0, AFTER_STRIKE_S, AFTER_STRIKE_ROWS)
        spread = np.concatenate([spread, np.interp(begins, timeline.t, np.arange(len(timeline.t)))])
    return np.unique(spread.round().astype(np.int64))


def find_covered_region(timeline: BallTimeline) -> BoolArray:
    """Return the reference pixels (H, W) that a moving ball with its surroundings ever affects."""
    camera = timeline.scene.camera
    region = np.zeros((camera.height_px, camera.width_px), dtype=np.uint8)
    for row in np.flatnonzero(timeline.moving.any(axis=1)):
        for ball in timeline.balls_to_matte(int(row)):
            for side in (int(row), int(row) + 1):
                if np.isfinite(timeline.centre[side, ball]).all():
                    _mark_outline(
                        region, timeline.outline(side, ball), timeline.camera_motion_at(float(timeline.t[side]))
                    )
    return region > 0


def _mark_outline(mask: ImageArray, outline: BallOutline, motion: FloatArray | None) -> None:
    """Mark in reference pixels all that a ball can affect."""
    to_reference = np.eye(3) if motion is None else np.linalg.inv(motion)
    path = apply_homography(np.asarray(to_reference, dtype=np.float64), outline.path)
    thickness = int(np.ceil(2 * outline.reach)) + 8
    points = np.rint(np.concatenate([path, path[-1:]])).astype(np.int32)
    cv2.polylines(mask, [points.reshape(-1, 1, 2)], isClosed=False, color=255, thickness=thickness)
    cv2.circle(mask, points[0].tolist(), thickness // 2, 255, -1)


def _build_sample(
    timeline: BallTimeline, row: int, image: ImageArray
) -> tuple[ImageArray, ImageArray, FloatArray | None]:
    """Return a frame, its coverage mask (H, W) of balls and shadows, and its camera motion."""
    covered = np.zeros(image.shape[:2], dtype=np.uint8)
    located = np.flatnonzero(np.isfinite(timeline.centre[row, :, 0]))
    outlines = [timeline.outline(row, int(ball)) for ball in located]
    for level, radii in ((COVERED_BY_SHADOW, SHADOW_RADII), (COVERED_BY_BALL, HIDDEN_RADII)):
        for outline in outlines:
            radius = int(np.ceil(radii * outline.radius + outline.edge_width))
            for point in np.rint(outline.path).astype(int):
                cv2.circle(covered, point.tolist(), radius, level, -1)
    return image, covered, timeline.camera_motion_at(float(timeline.t[row]))
