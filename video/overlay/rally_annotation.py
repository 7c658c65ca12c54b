"""What is drawn over the frames of a rally: trail, ghosts, speeds, heights over the net, bounces, a plan, a clock."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from models.core.fit_result import SURE_PROBABILITY
from models.core.number_format import format_flight_speed, format_probability, format_time, format_with_sigma
from models.core.rally import Rally, RallyEvent
from models.core.typing import FloatArray, ImageArray
from models.estimation.rally.landing_judgement import LandingCall
from models.estimation.rally.stroke_summary import Stroke, find_current_stroke, sample_flights, summarize_strokes
from video.drawing.court_plan import SIDE_COLOURS, CourtDrawing, draw_court, draw_landing_mark, find_ellipse
from video.drawing.label_layout import COST_CELL_PX, LabelPosition, Rect, make_squares, place_label, place_panel
from video.drawing.masks import blend_colours, draw_disc, draw_ring, drawing_scale, round_corner_mask
from video.drawing.palette import FLASH, INK, WHITE, Colour
from video.io.video_options import OverlayStyle
from video.io.yuv_frame import Canvas
from video.overlay.frame_overlay import ClockPanel, FrameBalls, Label, draw_flash, draw_trail, keep_balls_on_top
from video.synthesis.rally_synthesis import InBetweenFrame, RallyTimeline

# s between points of a path.
PATH_STEP_S = 1 / 240
# s of the output video for which a mark stays legible, and over which it fades.
READING_S, FADE_S = 2.5, 0.5
# s of the clip for which an event flashes.
FLASH_S = 0.12
# s of the clip over which a trail fades to its least opacity.
TRAIL_S, LEAST_TRAIL = 1.2, 0.35
# Opacity of the ghosts of a stroke, and of the ring where an object flies that no frame shows.
GHOST_OPACITY, RING_DASHES = 0.5, 9
# px at scale 1 around a place beside which its label is.
LABEL_REACH = 8.0
# Longer side of the plan, share of the height of the frame.
PLAN_SHARE = 0.36
# px beyond which nothing of a line is in view.
MAX_PX = 1e4
# Levels of the Laplacian of a reduced frame that are detail as full as text, and its cost relative to that of court.
DETAIL_LEVELS, DETAIL_COST = 60.0, 3.0
# Colours of verdicts.
VERDICT_COLOURS: dict[str, Colour] = {"in": (64, 200, 110), "out": (255, 96, 96), "undecided": (255, 176, 32)}
# m, radius of the ring that a bounce draws on the surface, in radii of the object.
BOUNCE_RADII = 4.0
# Probability from which an event is drawn.
MIN_PROBABILITY = 0.5
# Relative error of a speed, and error of a height, m, from which a label would state nothing.
MAX_SPEED_ERROR, MAX_HEIGHT_ERROR = 0.3, 0.5


@dataclass(frozen=True, slots=True)
class RallyMark:
    """A moment that is labelled at its place."""

    t: float
    place: FloatArray
    """(3,) m."""
    label: Label
    covariance: FloatArray | None = None
    """(3, 3) m^2, of something on the surface."""


@dataclass(slots=True)
class RallyAnnotation:
    """Everything that is drawn over a rally. It stores places of labels, so draw in the order of time."""

    timeline: RallyTimeline
    strokes: tuple[Stroke, ...]
    paths: list[tuple[FloatArray, FloatArray]]
    """Times (n,), s, and places (n, 3), m, of every flight."""
    marks: tuple[RallyMark, ...]
    call: LandingCall
    style: OverlayStyle
    slow: float
    scale: float
    plan: CourtDrawing
    plan_place: Rect
    clock: ClockPanel
    clock_place: Rect
    plan_image: tuple[int, ImageArray] | None = None
    """Row of the frame until which the plan is drawn, and its image."""
    positions: dict[int, LabelPosition] = field(default_factory=dict)
    """Of the label of each mark."""

    def draw(self, frame: InBetweenFrame) -> Canvas:
        """Draw onto a frame, in place, and return its canvas."""
        image, t = frame.canvas, frame.t
        if self.style == "clean":
            return image
        none = np.zeros(1)
        radius = 2 * self.timeline.radius[self.timeline.locate_times(np.array([t]))[0]] + 2
        ball = FrameBalls(frame.centre[None], radius, none, np.zeros((1, 2)), none > 0, none > 0, none > 0)
        with keep_balls_on_top(image, ball):
            if self.style == "coach":
                self._draw_stroke(image, t)
                if not frame.is_seen:  # hidden, or too faint to be seen: where physics puts it
                    draw_ring(image, frame.centre, 6 * self.scale, 1.4 * self.scale, WHITE, GHOST_OPACITY, RING_DASHES)
            self._draw_marks(image, t)
        if self.style == "coach":
            self._draw_plan(image, t)
        self.clock.draw(image, self.clock_place, t, self.scale)
        return image

    def path_of(self, index: int, until: float = np.inf) -> tuple[FloatArray, FloatArray]:
        """Return times (n,), s, and places (n, 3), m, of a stroke up to a time."""
        first, last = self.strokes[index].hit.t - PATH_STEP_S, min(self.strokes[index].end, until)
        parts = [(t[inside], xyz[inside]) for t, xyz in self.paths if (inside := (t >= first) & (t <= last)).any()]
        if not parts:
            return np.empty(0), np.empty((0, 3))
        return np.concatenate([t for t, _ in parts]), np.concatenate([xyz for _, xyz in parts])

    def _draw_stroke(self, image: Canvas, t: float) -> None:
        """Draw the trail of the current stroke, and ghosts where frames show the object."""
        index = find_current_stroke(self.strokes, t)
        if index < 0 or t > self.strokes[index].end + READING_S / self.slow:
            return
        times, xyz = self.draw_trail(image, index, t)
        px, filmed = self.timeline.project(xyz, t), self.timeline.rally.t
        for row in np.flatnonzero((filmed > times[0]) & (filmed < times[-1])) if len(times) else ():
            place = px[np.argmin(np.abs(times - filmed[row]))]
            if np.isfinite(place).all():
                draw_disc(image, place, max(float(self.timeline.radius[row]), 2 * self.scale), WHITE, GHOST_OPACITY)

    def draw_trail(self, image: Canvas, index: int, t: float) -> tuple[FloatArray, FloatArray]:
        """Draw the path of a stroke up to a time in the frame of that time; return its times (n,) and places (n, 3)."""
        times, xyz = self.path_of(index, t)
        fade = np.clip(1 - (t - times) / TRAIL_S, LEAST_TRAIL, 1)
        colour = SIDE_COLOURS[self.strokes[index].hit.player]
        self._draw_line(image, xyz, t, fade, colour, 4 * self.scale)
        return times, xyz

    def _draw_line(
        self, image: Canvas, xyz: FloatArray, t: float, fade: FloatArray, colour: Colour, width: float
    ) -> None:
        """Draw a line through places (n, 3), m, with opacities (n,), as far as it is before the camera."""
        px = self.timeline.project(xyz, t)
        rows = np.flatnonzero((np.abs(np.nan_to_num(px, nan=np.inf)) < MAX_PX).all(axis=1))
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            draw_trail(image, px[run], fade[run], colour, width)

    def _draw_marks(self, image: Canvas, t: float) -> None:
        """Draw flashes and labels of recent moments."""
        for mark in self.marks:
            age = (t - mark.t) / FLASH_S
            if 0 <= age < 1 and mark.covariance is None:
                draw_flash(image, self.timeline.project(mark.place, t), 3 * self.scale, age, self.scale, 4.0)
        ages = [(t - mark.t) * self.slow for mark in self.marks]
        shown = {k: min((READING_S - age) / FADE_S, 1.0) for k, age in enumerate(ages) if 0 <= age < READING_S}
        panels = [self.clock_place, *([self.plan_place] if self.style == "coach" else [])]
        self.draw_labels(image, t, shown, panels)

    def draw_labels(self, image: Canvas, t: float, opacities: dict[int, float], obstacles: list[Rect]) -> None:
        """Draw labels of marks by their indices, with opacities, and the ellipses of those on the surface."""
        size, reach, rally = (image.shape[1], image.shape[0]), LABEL_REACH * self.scale, self.timeline.rally
        row = int(np.argmin(np.abs(rally.t - t)))
        players = rally.players[rally.players[:, 0] == rally.frame[row], 1:]
        path = np.concatenate([xyz for _, xyz in self.paths]) if self.paths else np.empty((0, 3))
        for k, opacity in opacities.items():
            mark = self.marks[k]
            centre = self.timeline.project(mark.place, t)
            if not np.isfinite(centre).all():
                continue
            if mark.covariance is not None:
                self._draw_on_surface(image, mark, t, opacity)
            box = mark.label.size(self.scale)
            if k not in self.positions:
                near = make_squares(self.timeline.project(path[::8], t), 6 * self.scale)
                people = np.hstack([players[:, :2], players[:, 2:] - players[:, :2]])
                taken = np.concatenate([np.array(obstacles).reshape(-1, 4), near, people])
                self.positions[k] = place_label(box, centre, reach, np.zeros(2), taken, size, None)
            corner = centre + self.positions[k].top_left_corner(box, reach)
            left, top = np.clip(corner, 0, np.subtract(size, box)).tolist()
            mark.label.draw(image, np.array([left, top]), self.scale, opacity)
            obstacles.append((left, top, float(box[0]), float(box[1])))

    def _draw_on_surface(self, image: Canvas, mark: RallyMark, t: float, opacity: float) -> None:
        """Draw a ring that lies on the surface, and the outline of two standard deviations of its place."""
        assert mark.covariance is not None
        radius = BOUNCE_RADII * self.timeline.rally.scene.sport.object.radius
        rings = (find_ellipse(np.eye(2) * radius**2, 1.0), find_ellipse(mark.covariance[:2, :2], 2.0))
        for ring, colour in zip(rings, (WHITE, FLASH), strict=True):
            outline = mark.place + np.column_stack([ring, np.zeros(len(ring))])
            self._draw_line(image, outline, t, np.full(len(ring), opacity), colour, 2.5 * self.scale)

    def _draw_plan(self, image: Canvas, t: float) -> None:
        """Draw the plan with the current stroke up to the last frame, and the object where it is now."""
        row = int(self.timeline.locate_times(np.array([t]))[0][0])
        if self.plan_image is None or self.plan_image[0] != row:
            self.plan_image = row, self.draw_plan(t)
        x, y = round(self.plan_place[0]), round(self.plan_place[1])
        width, height = self.plan.size
        blend_colours(image, self.plan_image[1], round_corner_mask(width, height, max(3, height // 40)), x, y)
        index = find_current_stroke(self.strokes, t)
        _, xyz = self.path_of(index, t) if index >= 0 else (None, np.empty((0, 3)))
        if len(xyz) and t <= self.strokes[index].end:
            at = np.array([x, y]) + self.plan.to_pixels(xyz[-1]) / 2
            draw_disc(image, at, 4 * self.scale, INK)
            draw_disc(image, at, 3 * self.scale, WHITE)

    def draw_plan(self, t: float) -> ImageArray:
        """Draw the strokes up to a time on the plan: the current one bright, the one before faint."""
        drawing, index = self.plan.copy(), find_current_stroke(self.strokes, t)
        for k in range(max(index - 1, 0), index + 1):
            colour = SIDE_COLOURS[self.strokes[k].hit.player]
            faint: Colour = (colour[0] // 2, colour[1] // 2, colour[2] // 2)
            drawing.draw_path(self.path_of(k, t)[1], colour if k == index else faint)
            drawing.draw_mark(self.strokes[k].hit.place, colour, 3.0)
        for mark in self.marks:
            if mark.covariance is not None and mark.t <= t and (index < 0 or mark.t >= self.strokes[index].hit.t):
                draw_landing_mark(drawing, mark.place, mark.covariance)
        return drawing.render()


def prepare_rally_annotation(
    timeline: RallyTimeline, call: LandingCall, first: ImageArray, slow: float, style: OverlayStyle
) -> RallyAnnotation:
    """Prepare what is drawn over a rally.

    Args:
        call: Verdict on its landing.
        first: A frame (H, W, 3), whose details panels shall not hide.
        slow: Slowdown of the video.
        style: What is drawn.
    """
    rally, camera = timeline.rally, timeline.rally.scene.camera
    size, scale = (camera.width_px, camera.height_px), drawing_scale(camera.height_px)
    strokes = summarize_strokes(rally)
    paths = [(one.t, one.xyz) for one in sample_flights(rally, PATH_STEP_S)]
    plan, clock = draw_court(rally.scene.sport, round(PLAN_SHARE * size[1])), ClockPanel(f"{slow:g}× slower")
    cost = find_panel_cost(timeline, first)
    crossed = [make_squares(timeline.project(xyz[::12], t[::12]), 12 * scale) for t, xyz in paths]
    crossed.append(make_squares(rally.px, 12 * scale))
    plan_place = place_panel(plan.size, size, cost, np.concatenate(crossed))
    crossed += [np.array([plan_place])] if style == "coach" else []
    clock_place = place_panel(clock.size(scale), size, cost, np.concatenate(crossed))
    marks = _collect_marks(rally, strokes, call, style)
    return RallyAnnotation(
        timeline, strokes, paths, marks, call, style, slow, scale, plan, plan_place, clock, clock_place
    )  # fmt: skip


def find_panel_cost(timeline: RallyTimeline, first: ImageArray) -> FloatArray:
    """Return the cost of what a panel hides on a coarse map (h, w): court and players of any frame, details of one."""
    rally, sport = timeline.rally, timeline.rally.scene.sport
    camera = rally.scene.camera
    cost = np.zeros((-(-camera.height_px // COST_CELL_PX), -(-camera.width_px // COST_CELL_PX)), np.uint8)
    corners = np.column_stack([sport.corners, np.zeros(4)])
    for row in np.linspace(0, len(rally.t) - 1, 5).astype(int):
        px = timeline.project(corners, float(rally.t[row]))
        if np.isfinite(px).all():
            cv2.fillConvexPoly(cost, np.rint(np.clip(px, -1e4, 1e4) / COST_CELL_PX).astype(np.int32), 1)
    for left, top, right, bottom in rally.players[::5, 1:] / COST_CELL_PX:
        cost[max(int(top), 0) : int(bottom) + 1, max(int(left), 0) : int(right) + 1] = 1
    grey = cv2.cvtColor(cv2.resize(first, cost.shape[::-1], interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
    detail = np.minimum(np.abs(cv2.Laplacian(grey, cv2.CV_32F)) / DETAIL_LEVELS, 1)
    return np.asarray(cost + DETAIL_COST * detail, dtype=np.float64)


def _collect_marks(
    rally: Rally, strokes: tuple[Stroke, ...], call: LandingCall, style: OverlayStyle
) -> tuple[RallyMark, ...]:
    """Collect hits with speeds, or with times for an umpire, crossings of the net, bounces and the landing."""
    marks = []
    for stroke in strokes:
        colour = SIDE_COLOURS[stroke.hit.player]
        if style == "umpire":
            label = Label("hit", format_time(stroke.hit.t, stroke.hit.t_sigma), colour)
            marks.append(RallyMark(stroke.hit.t, stroke.hit.place, label))
            continue
        is_measured = stroke.hit.speed_sigma < MAX_SPEED_ERROR * stroke.hit.speed
        if stroke.hit.probability >= MIN_PROBABILITY and is_measured:
            speed = format_flight_speed(stroke.hit.speed, stroke.hit.speed_sigma)
            marks.append(RallyMark(stroke.hit.t, stroke.hit.place, Label(speed, "", colour)))
        if stroke.net is not None and not stroke.net.is_touch and stroke.net.height_sigma < MAX_HEIGHT_ERROR:
            height = format_with_sigma(100 * abs(stroke.net.height), 100 * stroke.net.height_sigma, 0)
            label = Label("net", f"{height} cm {'over' if stroke.net.height >= 0 else 'below'} its edge", colour)
            marks.append(RallyMark(stroke.net.t, stroke.net.place, label))
    landing = call.landing
    for event in rally.events:
        is_last = landing is not None and abs(event.t - landing.t) < FLASH_S / 2
        if event.probability >= MIN_PROBABILITY and event.kind != "hit" and not is_last:
            covariance = event.covariance if event.kind in ("bounce", "landing") else None
            marks.append(RallyMark(event.t, event.place, _label_event(event), covariance))
    if landing is not None and rally.no_landing < MIN_PROBABILITY:
        marks.append(RallyMark(landing.t, landing.place, label_verdict(call), landing.covariance))
    return tuple(sorted(marks, key=lambda mark: mark.t))


def _label_event(event: RallyEvent) -> Label:
    """Label a bounce, a touch of the net or a landing."""
    doubt = "" if event.probability >= SURE_PROBABILITY else f"  {format_probability(event.probability)}"
    value = f"{format_time(event.t, event.t_sigma)}{doubt}"
    return Label({"net": "touches the net"}.get(event.kind, event.kind), value, FLASH)


def label_verdict(call: LandingCall) -> Label:
    """Label the verdict on a landing with its probability."""
    colour = VERDICT_COLOURS[call.verdict]
    if call.verdict == "undecided":
        return Label("cannot be decided", f"in: {format_probability(call.probability)}", colour)
    probability = call.probability if call.verdict == "in" else call.out_probability
    return Label(call.verdict.upper(), format_probability(probability), colour)
