"""What moving balls hide: the background, estimated from the whole clip, and which balls a frame shows before it."""

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
from video.matting.ball_matting import SHADOW_RADII, BallOutline, Box, find_box
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


# Radii around its centre in which the colour of a ball is measured, and share of its box that must be unoccluded.
INNER_RADII, MIN_VISIBLE_SHARE = 0.7, 0.08
# Radii around its centre between which an isolated ball is surrounded by table.
RING_RADII = (1.3, 1.7)
# Levels of 255 by which a pixel may differ from the table in any usual light.
MAX_TABLE_LEVELS = 28.0


def find_visible_balls(timeline: BallTimeline, plate: BackgroundPlate, row: int, image: ImageArray) -> BoolArray:
    """Find the balls that are visible in a frame: the observed ones, and those whose place differs from the background.

    A half-occluded ball counts as visible if its visible part is no table; that part may be its number alone. A whole
    ball must have its own colour, or be a disc of other colours with table all round, because a striped ball rotates.

    Args:
        timeline: Positions of the balls.
        plate: Background plate.
        row: Row of the frame.
        image: Frame (H, W, 3).

    Returns:
        Visible balls (N,).
    """
    is_visible: BoolArray = timeline.observed[row].copy()
    for ball in np.flatnonzero(~is_visible & np.isfinite(timeline.centre[row, :, 0])):
        box, inner, visible = _visible_part(timeline, row, int(ball), image.shape)
        if visible.sum() < MIN_VISIBLE_SHARE * max(visible.size, 1):
            continue
        x, y, width, height = box
        plate_patch, valid = plate.extract_patch(*box, timeline.camera_motion_at(float(timeline.t[row])))
        if not valid.all():
            continue
        pixels, empty = (p[visible].astype(np.float32) for p in (image[y : y + height, x : x + width], plate_patch))
        if visible.sum() < inner.sum():
            is_visible[ball] = np.mean(np.abs(pixels - empty).max(axis=1) > MAX_TABLE_LEVELS) > 0.5
        else:
            mean = pixels.mean(axis=0)
            near = np.linalg.norm(mean - timeline.colour[ball]) < np.linalg.norm(mean - empty.mean(axis=0))
            is_visible[ball] = near or _is_disc_on_table(timeline, plate, row, int(ball), image)
    return is_visible


def _is_disc_on_table(timeline: BallTimeline, plate: BackgroundPlate, row: int, ball: int, image: ImageArray) -> bool:
    """Return whether the ball's place is no table and its surroundings are, which excludes hands and cues."""
    centre, radius = timeline.centre[row, ball], float(timeline.radius[row, ball])
    x, y, width, height = box = find_box(centre[None], RING_RADII[1] * radius, image.shape)
    plate_patch, valid = plate.extract_patch(*box, timeline.camera_motion_at(float(timeline.t[row])))
    if not valid.all():
        return False
    unlike = (
        np.abs(image[y : y + height, x : x + width].astype(np.float32) - plate_patch).max(axis=2) > MAX_TABLE_LEVELS
    )
    distance = BallOutline(centre[None], centre, radius).distance_to_path(*box) / radius
    inner, ring = unlike[distance < INNER_RADII], unlike[(distance > RING_RADII[0]) & (distance < RING_RADII[1])]
    return bool(inner.size and ring.size and inner.mean() > 0.5 > ring.mean())


def _visible_part(
    timeline: BallTimeline, row: int, ball: int, shape: tuple[int, ...]
) -> tuple[Box, BoolArray, BoolArray]:
    """Return the box x, y, width, height of a ball, its pixels (h, w) there, and those that no other ball occludes."""
    centre, radius = timeline.centre[row, ball], float(timeline.radius[row, ball])
    box = find_box(centre[None], radius, shape)
    inner: BoolArray = BallOutline(centre[None], centre, radius).distance_to_path(*box) < INNER_RADII * radius
    visible = inner.copy()
    for other in np.flatnonzero(timeline.observed[row] & (timeline.centre[row, :, 1] > centre[1])):
        outline = timeline.outline(row, int(other))
        visible &= outline.distance_to_path(*box) > outline.radius + outline.edge_width
    return box, inner, visible
