"""Poster of a shot: a still image with the balls along their paths and the contacts with their times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import COST_CELL_PX, Rect, overlap_share, place_label, place_panel
from video.drawing.masks import draw_disc, draw_ring
from video.drawing.palette import FLASH, INK, WHITE, ensure_contrast
from video.io.clip import Clip
from video.io.video_options import RenderOptions
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import MattedSprite, matte_balls
from video.matting.ball_timeline import BallTimeline, read_rows
from video.matting.compositing import SpriteLayer, composite_balls
from video.matting.hidden_background import HiddenBackground
from video.overlay.annotation import DEFAULT_OPTIONS, Annotation, prepare_annotation
from video.overlay.close_up import draw_polyline
from video.overlay.frame_overlay import LABEL_LETTERS, FrameBalls, Label, draw_trail, keep_balls_on_top
from video.overlay.motion_paths import EVENT_STRENGTHS

# Ball radii between two ghosts of a ball.
GHOST_SPACING_RADII = 5.0
# Opacity of the ghosts.
GHOST_OPACITY = 0.5
# px at scale 1: radii about a spot beside which its label may be; a line leads to it.
LABEL_REACHES = (12.0, 40.0)
# Width of a phone's page, and the least font size on it that people read without zooming, CSS px.
PHONE_WIDTH, LEAST_LETTERS = 390.0, 9.0


def draw_poster(
    clip: Clip, background: HiddenBackground, tracks: Tracks, fit: Fit, options: RenderOptions = DEFAULT_OPTIONS
) -> ImageArray:
    """Draw the last frame of a shot with stroboscopic ghosts of every ball, and its contacts.

    Args:
        background: Positions of its balls, and the background without the moving ones.
        tracks: Tracks of the balls.
        fit: Fitted motion and events.
        options: Options of the slow motion, for the labels.

    Returns:
        Image (H, W, 3), with the strip that the slow motion has.
    """
    timeline, positions = background.timeline, _select_ghost_positions(background.timeline)
    ghosts: list[tuple[MattedSprite, FloatArray]] = []
    first: ImageArray | None = None
    for row, image in read_rows(clip, timeline, {0, len(timeline.t) - 1, *(row for row, _ in positions)}):
        first = image if first is None else first
        chosen = [ball for k, ball in positions if k == row]
        ghosts += _extract_ghosts(timeline, background.plate, row, image, chosen)
    assert first is not None
    annotation = prepare_annotation(timeline, tracks, fit, first, options.slow)
    still = annotation.extend(image.copy())
    frame = still[: len(still) - annotation.strip_height]
    end = float(timeline.t[-1])
    for sprite, place in ghosts:
        composite_balls(frame, [[SpriteLayer(sprite, place[None], GHOST_OPACITY)]])
    ball_count = len(annotation.paths)
    centre = timeline.centre[-1]
    none, zeros = np.zeros(ball_count, dtype=bool), np.zeros((ball_count, 2))
    balls = FrameBalls(centre, timeline.radius[-1], zeros[:, 0], zeros, none, none, ~none)
    left, top = (round(v) for v in annotation.inset_place[:2])
    with keep_balls_on_top(frame, balls):
        for ball, path in enumerate(annotation.paths):
            if len(path.t):
                trail = timeline.project(path.xy, end)
                width = float(np.clip(0.3 * path.radius, 2.0, 6 * annotation.scale))
                draw_trail(frame, trail, np.full(len(trail), 0.9), annotation.trail_colours[ball], width)
        for path, colour in zip(annotation.paths, annotation.colours, strict=True):
            annotation.inset.add_path(annotation.plan_canvas, path.xy, colour)
        plan = annotation.inset.reduce_canvas(annotation.plan_canvas)
        annotation.inset.draw_with_balls(still, left, top, plan, fit.trajectory.at(end).xy, annotation.colours)
        _draw_labels(frame, timeline, annotation, balls, sum(kind in EVENT_STRENGTHS for kind in fit.events.kind))
    return still


def _select_ghost_positions(timeline: BallTimeline) -> list[tuple[int, int]]:
    """Return row and ball of every ghost, spaced along the path of the ball."""
    positions = []
    for ball in np.flatnonzero(timeline.moving.any(axis=0)):
        rows = np.flatnonzero(timeline.moving[:, ball])
        last = timeline.centre[-1, ball]
        placed = [last] if np.isfinite(last).all() else []
        for row in rows:
            place, radius = timeline.centre[row, ball], float(timeline.radius[row, ball])
            if not timeline.observed[row, ball] or not np.isfinite(radius):
                continue
            if all(np.linalg.norm(place - other) > GHOST_SPACING_RADII * radius for other in placed):
                placed.append(place)
                positions.append((int(row), int(ball)))
    return positions


def _extract_ghosts(
    timeline: BallTimeline, plate: BackgroundPlate, row: int, image: ImageArray, balls: Sequence[int]
) -> list[tuple[MattedSprite, FloatArray]]:
    """Return the sprites of some balls of a frame, and their positions in pixels of the last frame."""
    others = [int(b) for b in np.flatnonzero(np.isfinite(timeline.centre[row, :, 0])) if b not in balls]
    outlines, remaining = ([timeline.outline(row, ball) for ball in group] for group in (balls, others))
    matted = matte_balls(image, outlines, remaining, plate, timeline.camera_motion_at(float(timeline.t[row])))
    end = float(timeline.t[-1])
    xy = timeline.scene.camera.to_table(
        timeline.centre[row], timeline.scene.table.ball_radius,
        None if timeline.scene.camera.motion is None else int(timeline.frame[row]),
    )  # fmt: skip
    places = timeline.project(xy, end)
    return [(sprite, places[ball]) for sprite, ball in zip(matted.sprites, balls, strict=True) if sprite is not None]


def _draw_labels(
    still: ImageArray, timeline: BallTimeline, annotation: Annotation, balls: FrameBalls, count: int
) -> None:
    """Draw contacts with their times, names at the starts of the balls, and how many contacts have no label."""
    end, scale = float(timeline.t[-1]), annotation.scale
    bounds = (still.shape[1], still.shape[0])
    crossed = np.vstack([balls.boxes(0.3), annotation.path_squares(end, -np.inf, np.inf, balls=True)])
    obstacles: list[Rect] = [annotation.inset_place, *crossed.tolist()]
    order = sorted(annotation.marks, key=lambda mark: (-mark.opacity, -mark.strength, mark.t))
    labels = [replace(mark.label, value=mark.label.value.partition(" ±")[0]) for mark in order]  # the report has errors
    times = [(label, timeline.project(one.xy, end), one.opacity) for label, one in zip(labels, order, strict=True)]
    names = []
    for mark in annotation.marks:
        spot = timeline.project(mark.xy, end)
        draw_disc(still, spot, 3.4 * scale, INK, 0.8 * mark.opacity)
        draw_disc(still, spot, 2.3 * scale, FLASH, mark.opacity)
    for ball, path in enumerate(annotation.paths):
        if len(path.t):
            start = timeline.project(path.xy[0], end)
            draw_ring(still, start, path.radius + 2.5 * scale, 1.6 * scale, WHITE, 0.8)
            names.append((Label(annotation.names[ball], "", annotation.colours[ball]), start, 1.0))
    letters = max(scale, bounds[0] * LEAST_LETTERS / PHONE_WIDTH / LABEL_LETTERS)
    placed = []
    for k, (label, spot, opacity) in enumerate([*times, *names]):
        rect = _find_free_place(label.size(letters), spot, scale, obstacles, bounds)
        if rect is not None:
            placed.append((label, spot, np.array(rect), opacity))
            obstacles.append(rect)
            count -= k < len(times)
    for label, spot, box, _ in placed:
        leader = np.stack([spot, np.clip(spot, box[:2], box[:2] + box[2:])])
        draw_polyline(still, leader, round(3 * scale), INK)
        draw_polyline(still, leader, max(1, round(scale)), ensure_contrast(label.colour, INK))
    for label, _, box, opacity in placed:
        label.draw(still, box[:2], letters, opacity)
    if count:
        note = Label(f"{count} more contact{'s' * (count > 1)}", "", FLASH)
        cost = np.zeros((bounds[1] // COST_CELL_PX, bounds[0] // COST_CELL_PX))
        place = place_panel(note.size(letters), bounds, cost, obstacles)
        note.draw(still, np.array(place[:2]), letters)


def _find_free_place(
    size: tuple[int, int], spot: FloatArray, scale: float, obstacles: Sequence[Rect], bounds: tuple[int, int]
) -> Rect | None:
    """Find the nearest place for a label of a spot (2,) px where it hides nothing; None where there is none."""
    for radius in (scale * reach for reach in LABEL_REACHES):
        place = place_label(size, spot, radius, np.zeros(2), obstacles, bounds, None)
        left, top = (spot + place.top_left_corner(size, radius)).tolist()
        rect = (left, top, float(size[0]), float(size[1]))
        is_inside = 0 <= left <= bounds[0] - size[0] and 0 <= top <= bounds[1] - size[1]
        if is_inside and not overlap_share(rect, obstacles):
            return rect
    return None
