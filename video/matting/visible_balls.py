"""Selection of the balls that are visible in a frame, whether detected there or not."""

from __future__ import annotations

import numpy as np

from models.core.typing import BoolArray, FloatArray, ImageArray
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import BallOutline
from video.matting.ball_timeline import BallTimeline

# x, y, width, height
Box = tuple[int, int, int, int]

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
    x, y, width, height = box = _box_around(centre, RING_RADII[1] * radius, image.shape)
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
    box = _box_around(centre, radius, shape)
    inner: BoolArray = BallOutline(centre[None], centre, radius).distance_to_path(*box) < INNER_RADII * radius
    visible = inner.copy()
    for other in np.flatnonzero(timeline.observed[row] & (timeline.centre[row, :, 1] > centre[1])):
        outline = timeline.outline(row, int(other))
        visible &= outline.distance_to_path(*box) > outline.radius + outline.edge_width
    return box, inner, visible


def _box_around(centre: FloatArray, reach: float, shape: tuple[int, ...]) -> Box:
    """Return the pixels within `reach` px of a place, cut at the border."""
    x0, y0 = (int(v) for v in np.maximum(np.floor(centre - reach), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(centre + reach) + 1, [shape[1], shape[0]]))
    return x0, y0, max(x1 - x0, 0), max(y1 - y0, 0)
