"""Annotation of a shot, prepared once: trails, names, contact times, panels and their placement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import (
    COST_CELL_PX,
    PANEL_MARGIN,
    LabelPosition,
    Rect,
    make_squares,
    overlap_share,
    place_label,
    place_panel,
)
from video.drawing.masks import drawing_scale
from video.drawing.palette import INK, Colour, ensure_contrast, lab_to_rgb
from video.drawing.table_plan import TableInset, build_table_inset
from video.io.video_options import OverlayStyle, RenderOptions
from video.io.yuv_frame import Canvas, Image, YuvFrame
from video.matting.ball_timeline import BallTimeline
from video.overlay.frame_overlay import (
    CONTACT_RADII,
    ClockPanel,
    FrameBalls,
    Label,
    draw_flash,
    draw_measured_rings,
    draw_trail,
    keep_balls_on_top,
)
from video.overlay.motion_paths import POINTS_APART, ContactMark, MotionPath, sample_motion_path, select_contact_marks

# s of the shot that a trail spans.
TRAIL_S = 0.9
# s of the shot for which a contact flashes.
FLASH_S = 0.15
# s of the output video for which the time of a contact stays legible.
READING_S = 2.0
# Points of a path per point on the plan, which is small.
PLAN_POINT_STEP = 3
# Names and contact times shown at once; more would hide the shot.
MAX_LABELS, MAX_CONTACT_TIMES = 6, 3
# Share of the remaining way that a label moves per frame, so that it glides rather than jumps.
GLIDE_SHARE = 0.12
# Change of a label's opacity per frame after it was absent: it disappears at once where it would hide something.
FADE_IN_STEP = 0.1
# Ball radii around each ball that stay free of labels.
NAME_MARGIN_RADII = 0.3
# Longer side of the plan, share of the frame width.
INSET_SHARE = 0.23
# Costs of hidden table, pockets and image detail.
TABLE_COST, POCKET_COST, DETAIL_COST = 1.0, 2.0, 1.5
# Ball radii around the centres of all balls, at any time, that no panel covers.
PANEL_GAP_RADII = 1.3


# Options of the default slow motion.
DEFAULT_OPTIONS = RenderOptions()


@dataclass(slots=True)
class GlidingLabels:
    """Labels that glide beside their balls from frame to frame, and fade where space is missing."""

    positions: dict[int, tuple[LabelPosition, LabelPosition]] = field(default_factory=dict)
    """Target and current position of each ball's label."""
    opacity: dict[int, float] = field(default_factory=dict)

    def draw(
        self, image: Canvas, label: Label, ball: int, balls: FrameBalls, scale: float, obstacles: list[Rect],
        opacity: float = 1.0,
    ) -> None:  # fmt: skip
        """Draw the label of a ball where it covers no obstacle, and append its place to the obstacles."""
        size, centre, radius = label.size(scale), balls.centre[ball], balls.radius_of(ball)
        aim, now = self.positions.get(ball, (None, None))
        taken = np.array(obstacles, dtype=np.float64).reshape(-1, 4)
        aim = place_label(size, centre, radius, balls.heading[ball], taken, _image_size(image), aim)
        now = now.move_towards(aim, GLIDE_SHARE) if now is not None and self.opacity.get(ball, 0.0) > 0 else aim
        self.positions[ball] = aim, now
        rect = _fit_inside(centre + now.top_left_corner(size, radius), size, image)
        self.opacity[ball] = 0.0 if overlap_share(rect, taken) else min(self.opacity.get(ball, 1.0) + FADE_IN_STEP, 1.0)
        _draw_label(image, label, rect, scale, opacity * self.opacity[ball], obstacles)


@dataclass(slots=True)
class Annotation:
    """Everything that is drawn over the frames of a shot. It tracks label positions, so draw in the order of time."""

    timeline: BallTimeline
    colours: tuple[Colour, ...]
    trail_colours: tuple[Colour, ...]
    """Colours of the trails, which contrast with the cloth."""
    names: tuple[str, ...]
    paths: tuple[MotionPath, ...]
    path_points: FloatArray
    """Result of `_collect_path_points`."""
    marks: tuple[ContactMark, ...]
    inset: TableInset
    inset_place: Rect
    plan_canvas: ImageArray
    """Canvas of the inset with the paths so far."""
    plan: ImageArray
    """The same in its final size."""
    clock: ClockPanel
    clock_place: Rect
    scale: float
    reading_time: float
    """s of the shot for which a contact time is shown."""
    strip_height: int = 0
    """px below the frame for plan and clock, where balls cross every place in it; 0 where they do not."""
    labels: GlidingLabels = field(default_factory=GlidingLabels)
    """Names of the balls."""
    name_rects: list[Rect] = field(default_factory=list)
    """Rectangles of the names on the frame before."""
    mark_positions: dict[int, LabelPosition] = field(default_factory=dict)
    """Position of the label of each mark."""
    crowded_marks: set[int] = field(default_factory=set)
    """Marks whose label has no space."""
    style: OverlayStyle = "coach"
    last_plan_points: dict[int, int] = field(default_factory=dict)
    """Index of the last path point of each ball on the plan."""

    def draw(self, image: Image, t: float, balls: FrameBalls, xy: FloatArray) -> Image:
        """Draw onto an image, in place where there is no strip below it.

        Args:
            image: The frame.
            t: Its time, s.
            balls: The balls on it, which nothing covers.
            xy: Positions of the balls (N, 2), m.

        Returns:
            The frame with its strip of `strip_height`.
        """
        whole, rows = self.extend(image), image.shape[0]
        frame = whole.crop_rows(rows) if isinstance(whole, YuvFrame) else whole[:rows]
        with keep_balls_on_top(frame, balls):
            if self.style != "clean":
                self._draw_motion(frame, t, balls)
                self._draw_panels(whole, t, xy)
                self._draw_labels(frame, t, balls)
            elif self.clock.trust_level != "green":
                self.clock.draw(whole, self.clock_place, t, self.scale)
        return whole

    def extend(self, image: Image) -> Image:
        """Return an image with an empty strip below it, if there is one."""
        if not self.strip_height:
            return image
        if isinstance(image, YuvFrame):
            return image.extend(self.strip_height, INK)
        return np.concatenate([image, np.full((self.strip_height, *image.shape[1:]), INK, dtype=np.uint8)])

    def _draw_motion(self, image: Canvas, t: float, balls: FrameBalls) -> None:
        """Draw trails, rings and the flashes of contacts."""
        if self.style == "coach":
            for ball, path in enumerate(self.paths):
                self._draw_trail(image, t, path, balls.centre[ball], self.trail_colours[ball])
        draw_measured_rings(image, balls, self.colours, self.scale)
        for mark in self.marks:
            if 0 <= t - mark.t < FLASH_S:
                centre = self.timeline.project(mark.xy, t)
                radius = balls.radius_of(mark.ball)
                draw_flash(image, centre, radius, (t - mark.t) / FLASH_S, self.scale, mark.strength, mark.opacity)

    def _draw_labels(self, image: Canvas, t: float, balls: FrameBalls) -> None:
        """Draw contact times and names beside everything else."""
        panels = [] if self.strip_height else [self.inset_place, self.clock_place]
        obstacles: list[Rect] = [*panels, *balls.boxes(NAME_MARGIN_RADII).tolist()]
        trails = self.path_squares(t, t - TRAIL_S, t)
        self._draw_contact_times(image, t, balls, obstacles)
        if self.style == "coach":
            self._draw_names(image, t, balls, [*obstacles, *trails.tolist()])

    def path_squares(self, t: float, first: float, last: float, balls: bool = False) -> FloatArray:
        """Return squares (n, 4) px, in the frame at time t, along the paths from one time to another.

        They enclose the line of a path, or with `balls` the balls that follow it.
        """
        points = self.path_points[(first <= self.path_points[:, 0]) & (self.path_points[:, 0] < last)]
        return make_squares(self.timeline.to_frame_pixels(points[:, 1:3], t), points[:, 4 if balls else 3])

    def _draw_trail(self, image: Canvas, t: float, path: MotionPath, centre: FloatArray, colour: Colour) -> None:
        """Draw the recent path of a ball."""
        if not len(path.t) or not path.t[0] < t <= path.t[-1] + TRAIL_S:
            return
        points = path.line_points[slice(*np.searchsorted(path.t[path.line_points], [t - TRAIL_S, t]))]
        trail = self.timeline.to_frame_pixels(path.px[points], t)
        age = (t - path.t[points]) / TRAIL_S
        if np.isfinite(centre).all():
            trail, age = np.concatenate([trail, centre[None]]), np.append(age, 0.0)
        fade = np.clip(1 - age, 0, 1) ** 1.3
        draw_trail(image, trail, fade, colour, _trail_width(path, self.scale))

    def _draw_panels(self, image: Canvas, t: float, xy: FloatArray) -> None:
        """Draw the plan and the clock."""
        lines = self.last_plan_points.copy()
        for ball, path in enumerate(self.paths):
            first, last = self.last_plan_points.get(ball, 0), int(path.t.searchsorted(t))
            if last - first > PLAN_POINT_STEP:
                points = np.arange(first, last, PLAN_POINT_STEP)
                self.inset.add_path(self.plan_canvas, path.xy[points], self.colours[ball])
                self.last_plan_points[ball] = int(points[-1])
        if lines != self.last_plan_points:
            self.plan = self.inset.reduce_canvas(self.plan_canvas)
        left, top = (round(v) for v in self.inset_place[:2])
        self.inset.draw_with_balls(image, left, top, self.plan, xy, self.colours)
        self.clock.draw(image, self.clock_place, t, self.scale)

    def _draw_contact_times(self, image: Canvas, t: float, balls: FrameBalls, obstacles: list[Rect]) -> None:
        """Draw the times of the last contacts, sure ones first, each at its first position."""
        recent = [k for k, mark in enumerate(self.marks) if 0 <= t - mark.t < self.reading_time]
        recent.sort(key=lambda k: (self.marks[k].is_sure, k))
        for k in sorted(recent[-MAX_CONTACT_TIMES:]):
            mark, spot = self.marks[k], self.timeline.project(self.marks[k].xy, t)
            size, radius = mark.label.size(self.scale), CONTACT_RADII * balls.radius_of(mark.ball)
            if k not in self.mark_positions:
                crossed = self.path_squares(t, t - TRAIL_S, t + self.reading_time, balls=True)
                avoided = [*obstacles, *self.name_rects, *crossed.tolist()]
                self.mark_positions[k] = place_label(size, spot, radius, np.zeros(2), avoided, _image_size(image), None)
                rect = _fit_inside(spot + self.mark_positions[k].top_left_corner(size, radius), size, image)
                self.crowded_marks |= {k} if overlap_share(rect, avoided) else set()
            rect = _fit_inside(spot + self.mark_positions[k].top_left_corner(size, radius), size, image)
            if k in self.crowded_marks or overlap_share(rect, obstacles):
                continue
            age = (t - mark.t) / self.reading_time
            opacity = mark.opacity * float(np.clip(min(age * 12, (1 - age) * 5), 0, 1))
            _draw_label(image, mark.label, rect, self.scale, opacity, obstacles)

    def _draw_names(self, image: Canvas, t: float, balls: FrameBalls, obstacles: list[Rect]) -> None:
        """Draw name and speed beside balls that move or recently stopped."""
        named = [
            int(ball) for ball in balls.present if self._name_opacity(t, int(ball)) > 0 and balls.is_supported[ball]
        ]
        named.sort(key=lambda ball: (-len(self.paths[ball].t), ball))
        name_start = len(obstacles)
        for ball in named[:MAX_LABELS]:
            speed = balls.speed[ball]
            label = Label(self.names[ball], f"{speed:.2f} m/s" if np.isfinite(speed) else "", self.colours[ball])
            self.labels.draw(image, label, ball, balls, self.scale, obstacles, self._name_opacity(t, ball))
        self.name_rects = obstacles[name_start:]

    def _name_opacity(self, t: float, ball: int) -> float:
        """Return the opacity of a ball's name, which fades in and out with its motion."""
        most = 0.0
        for start, end in self.paths[ball].spans.tolist():
            since = (t - start) / (0.1 * self.reading_time)
            remaining = (end + 0.3 * self.reading_time - t) / (0.2 * self.reading_time)
            most = max(most, min(since, remaining, 1.0))
        return most


def _trail_width(path: MotionPath, scale: float) -> float:
    """Return the width of the trail of a path, px."""
    return float(np.clip(0.42 * path.radius, 2.2, 9 * scale))


def _collect_path_points(paths: Sequence[MotionPath], scale: float) -> FloatArray:
    """Return the points of the lines of all paths (n, 5): s, reference px, and half widths of their trail and ball."""
    rows = [np.empty((0, 5))]
    for path in paths:
        halves = max(_trail_width(path, scale) / 2 + 2, POINTS_APART), path.radius
        points = path.line_points
        rows.append(np.column_stack([path.t[points], path.px[points], np.tile(halves, (len(points), 1))]))
    return np.concatenate(rows)


def _image_size(image: Canvas) -> tuple[int, int]:
    """Return width and height, px."""
    return image.shape[1], image.shape[0]


def _fit_inside(corner: FloatArray, size: tuple[int, int], image: Canvas) -> Rect:
    """Return the rectangle of a label of `size` (w, h) px, moved into the image."""
    left, top = np.maximum(np.minimum(corner, np.subtract(_image_size(image), size) - 2), 2)
    return float(left), float(top), float(size[0]), float(size[1])


def _draw_label(image: Canvas, label: Label, rect: Rect, scale: float, opacity: float, obstacles: list[Rect]) -> None:
    """Draw a label and append its rectangle to the obstacles."""
    if opacity > 0:
        label.draw(image, np.array(rect[:2]), scale, opacity)
        obstacles.append(rect)


def prepare_annotation(
    timeline: BallTimeline, tracks: Tracks, fit: Fit, first: ImageArray, slow: float, style: OverlayStyle = "coach"
) -> Annotation:
    """Prepare the annotation of a shot.

    Args:
        timeline: Positions of the balls.
        tracks: Names, classes and colours of the balls.
        fit: Fitted motion, events and trust level.
        first: First frame (H, W, 3).
        slow: Slowdown factor of the output video.
        style: Overlay style.

    Returns:
        The annotation.
    """
    height, width = first.shape[:2]
    scale = drawing_scale(height)
    paths = tuple(sample_motion_path(timeline, fit, ball) for ball in range(len(tracks.ids)))
    inset = build_table_inset(timeline.scene, round(INSET_SHARE * width))
    clock = ClockPanel(f"{slow:g}× slower", fit.trust.level, f"trust: {fit.trust.level}")
    cost, crossed = _panel_cost_map(timeline, first), _trace_balls(timeline, paths)
    inset_place = place_panel(inset.size, (width, height), cost, crossed)
    avoided = np.vstack([crossed, inset_place])
    clock_place = place_panel(clock.size(scale), (width, height), cost, avoided)
    strip_height, has_panels = 0, style != "clean" or fit.trust.level != "green"
    if has_panels and (overlap_share(inset_place, crossed) or overlap_share(clock_place, avoided)):
        inset_place, clock_place, strip_height = _place_below(inset.size, clock.size(scale), (width, height))
    colours = tuple(look.colour for look in tracks.looks)
    cloth = lab_to_rgb(timeline.scene.cloth_lab)
    return Annotation(
        timeline=timeline, names=tuple(look.name for look in tracks.looks),
        paths=paths, path_points=_collect_path_points(paths, scale), marks=select_contact_marks(timeline, fit),
        inset=inset, plan=inset.reduce_canvas(inset.canvas),
        colours=colours, trail_colours=tuple(ensure_contrast(colour, cloth) for colour in colours),
        inset_place=inset_place, plan_canvas=inset.canvas.copy(), clock=clock, clock_place=clock_place, scale=scale,
        reading_time=READING_S / slow, style=style, strip_height=strip_height,
    )  # fmt: skip


def _place_below(inset: tuple[int, int], clock: tuple[int, int], image: tuple[int, int]) -> tuple[Rect, Rect, int]:
    """Place two panels of (w, h) px in a strip below an image; return their rectangles and the height of the strip."""
    margin = round(PANEL_MARGIN * image[1])
    height = max(inset[1], clock[1]) + 2 * margin
    top = float(image[1] + margin)
    left = float(image[0] - margin - clock[0])
    places: tuple[Rect, Rect] = (float(margin), top, *inset), (left, top, *clock)
    return *places, height + (image[1] + height) % 2


def _trace_balls(timeline: BallTimeline, paths: Sequence[MotionPath]) -> FloatArray:
    """Return squares (n, 4) px of the frames that balls enter at any time."""
    squares = [make_squares(timeline.centre.reshape(-1, 2), PANEL_GAP_RADII * timeline.radius.ravel())]
    for path in paths:
        places = timeline.to_frame_pixels(path.px[:, None], path.t)[:, 0]
        squares.append(make_squares(places, PANEL_GAP_RADII * path.radius))
    return np.concatenate(squares)


def _panel_cost_map(timeline: BallTimeline, first: ImageArray) -> FloatArray:
    """Return the cost of what a panel would hide on a coarse map (h, w): table, pockets and image detail."""
    height, width = (-(-side // COST_CELL_PX) for side in first.shape[:2])
    grey = cv2.cvtColor(cv2.resize(first, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    detail = np.minimum(np.abs(cv2.Laplacian(grey, cv2.CV_32F)) / 60, 1) * DETAIL_COST
    table = np.zeros((height, width), dtype=np.uint8)
    cv2.fillPoly(table, [np.rint(timeline.scene.camera.corners_px / COST_CELL_PX).astype(np.int32)], 1)
    pockets: ImageArray = np.zeros((height, width), dtype=np.uint8)
    for x, y in timeline.project(timeline.scene.table.pocket_centres, float(timeline.t[0])) / COST_CELL_PX:
        cv2.circle(pockets, (round(x), round(y)), 5, 1, -1)
    return np.asarray(detail + table * TABLE_COST + pockets * POCKET_COST, dtype=np.float64)
