"""Paths of the balls and contact marks that the annotation of a shot shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.fit_result import SURE_PROBABILITY, Fit
from models.core.number_format import format_probability, format_time
from models.core.typing import FloatArray
from video.drawing.palette import FLASH
from video.matting.ball_timeline import BallTimeline
from video.overlay.frame_overlay import Label

# s between points of a path.
PATH_STEP = 1 / 240
# m/s below which a ball counts as resting.
MIN_SPEED = 2e-3
# px between drawn points of a path.
POINTS_APART = 6.0
# Ball radii that a ball must travel in a span that is drawn and named; less is noise or invisible.
MIN_TRAVEL_RADII = 0.4
# Least probability of a drawn event, see `models.estimation.shot_hypotheses`.
MIN_PROBABILITY = 0.1
# s, largest sigma of the time of a drawn event: others would flash at a wrong moment.
MAX_SIGMA = 0.05
# s, and largest number of contacts within that time that are drawn.
CROWDED_S, MAX_CROWDED = 0.03, 4
# Ball radii outside the noses up to which a path is drawn: includes pockets, excludes diverging fits.
OUTSIDE_RADII = 3.0
# Opacity of an event that is drawn faintly.
FAINT_OPACITY = 0.5
# Sizes of the flashes by event type.
EVENT_STRENGTHS = {"ball": 1.0, "strike": 0.75, "cushion": 0.65, "pocket": 0.8}
# Directions (x, y) from a ball to each cushion.
CUSHION_NORMALS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "top": (0.0, -1.0), "bottom": (0.0, 1.0)}


@dataclass(frozen=True, slots=True)
class MotionPath:
    """Path of one ball while it moves, n points in order of time; empty for a ball at rest."""

    t: FloatArray
    """(n,) s."""
    xy: FloatArray
    """(n, 2) m."""
    px: FloatArray
    """(n, 2) reference pixels."""
    spans: FloatArray
    """(k, 2) s, time spans of motion."""
    radius: float
    """px, median radius while the ball moves."""
    line_points: NDArray[np.intp]
    """Indices of the points that a line needs: all corners, and others some px apart."""


@dataclass(frozen=True, slots=True)
class ContactMark:
    """A drawn event."""

    t: float
    xy: FloatArray
    """(2,) m, point of contact."""
    ball: int
    strength: float
    label: Label
    opacity: float = 1.0

    @property
    def is_sure(self) -> bool:
        """Whether the event is drawn in full."""
        return self.opacity == 1.0


def sample_motion_path(timeline: BallTimeline, fit: Fit, ball: int) -> MotionPath:
    """Sample the motion of one ball while it moves, including the corners at events."""
    rows, spans = _find_motion_spans(timeline, ball)
    if not len(rows):
        none = np.empty((0, 2))
        return MotionPath(np.empty(0), none, none, none, 0.0, np.empty(0, dtype=np.intp))
    spans = _trim_spans(spans, fit, ball)
    parts = [np.arange(start, end, PATH_STEP) for start, end in spans]
    inside = [t for t in fit.events.t if ((spans[:, 0] <= t) & (t <= spans[:, 1])).any()]
    times = np.unique(np.concatenate([*parts, spans.ravel(), np.array(inside)]))
    xy = fit.trajectory.at(times).xy[:, ball]
    table, beyond = timeline.scene.table, OUTSIDE_RADII * timeline.scene.table.ball_radius
    on_table = ((xy > -beyond) & (xy < np.array([table.length, table.width]) + beyond)).all(axis=1)
    radii = timeline.radius[rows, ball]
    radius = float(np.median(radii[np.isfinite(radii)])) if np.isfinite(radii).any() else 8.0
    times, xy = times[on_table], xy[on_table]
    px = timeline.scene.camera.to_pixels(xy, table.ball_radius)
    drawn = thin_path_points(timeline.to_frame_pixels(px, float(timeline.t[0])), np.isin(times, inside))
    return MotionPath(times, xy, px, spans, radius, drawn)


def _find_motion_spans(timeline: BallTimeline, ball: int) -> tuple[NDArray[np.intp], FloatArray]:
    """Return rows (n,) and time spans (k, 2) s in which a ball travels, without rests and jitter."""
    rows = np.flatnonzero(timeline.moving[:, ball])
    runs = [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if _leaves_start(timeline, ball, run)]
    spans = [[timeline.t[run[0]], timeline.t[run[-1] + 1]] for run in runs]
    return np.concatenate([np.empty(0, dtype=np.intp), *runs]), np.array(spans).reshape(-1, 2)


def _leaves_start(timeline: BallTimeline, ball: int, rows: NDArray[np.intp]) -> bool:
    """Return whether a ball is ever `MIN_TRAVEL_RADII` from its position at the first of these neighbouring rows."""
    if not len(rows):
        return False
    run = slice(rows[0], rows[-1] + 2)
    away = np.linalg.norm(timeline.centre[run, ball] - timeline.centre[rows[0], ball], axis=1)
    travel = away / timeline.radius[run, ball]
    return bool(np.any(~np.isfinite(travel)) or travel.max() > MIN_TRAVEL_RADII)


def _trim_spans(spans: FloatArray, fit: Fit, ball: int) -> FloatArray:
    """Trim time spans (k, 2) s of whole gaps to the start and end of the fitted motion."""
    exact = spans.copy()
    for k, (start, end) in enumerate(spans):
        times = np.arange(start, end, PATH_STEP)
        speed = np.linalg.norm(fit.trajectory.at(times).v[:, ball], axis=1)
        moving = np.flatnonzero(speed > MIN_SPEED)
        if len(moving):
            exact[k] = times[moving[0]], min(times[moving[-1]] + PATH_STEP, end)
    return exact


def thin_path_points(px: FloatArray, corner: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return indices of points (n, 2) px at least `POINTS_APART` apart along the path, and of all corners (n,)."""
    if not len(px):
        return np.empty(0, dtype=np.intp)
    arc_length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(px, axis=0), axis=1))]) / POINTS_APART
    keep = corner | np.concatenate([[True], np.diff(np.floor(arc_length)) > 0])
    keep[-1] = True
    return np.flatnonzero(keep)


def select_contact_marks(timeline: BallTimeline, fit: Fit) -> tuple[ContactMark, ...]:
    """Select the events that are drawn: possible ones with an accurate time, and the hardest of many at once."""
    events = fit.events
    crowded = _find_crowded_contacts(events)
    marks = []
    for k, kind in enumerate(events.kind):
        is_reliable = events.probability[k] >= MIN_PROBABILITY and events.t_sigma[k] <= MAX_SIGMA
        if kind not in EVENT_STRENGTHS or not is_reliable or crowded[k] or events.a[k] not in fit.trajectory.ids:
            continue
        ball = fit.trajectory.ids.index(events.a[k])
        xy = _contact_point(timeline, fit, k)
        is_sure = events.probability[k] >= SURE_PROBABILITY
        probability_text = "" if is_sure else f"  {format_probability(events.probability[k])}"
        value = f"{format_time(float(events.t[k]), float(events.t_sigma[k]))}{probability_text}"
        a, b = fit.naming.name_ball(events.a[k]), events.b[k]
        title = {
            "ball": f"{a} – {fit.naming.name_ball(b)}", "cushion": f"{a} – {fit.naming.name_rail(b)}",
            "pocket": f"{a} – {fit.naming.name_pocket(b)}",
        }.get(kind, f"{a} struck")  # fmt: skip
        if np.isfinite(xy).all():
            label = Label(title if is_sure else f"{title} ?", value, FLASH)
            opacity = 1.0 if is_sure else FAINT_OPACITY
            marks.append(ContactMark(float(events.t[k]), xy, ball, EVENT_STRENGTHS[kind], label, opacity))
    return tuple(marks)


def _find_crowded_contacts(events: Events) -> NDArray[np.bool_]:
    """Return the ball contacts (E,) with `MAX_CROWDED` harder ones at the same time, as in a break shot.

    The speed of a contact counts by its probability.
    """
    expected_speed = np.nan_to_num(events.speed) * events.probability
    hard = np.where([kind == "ball" for kind in events.kind], expected_speed, -np.inf)
    near = np.abs(events.t[:, None] - events.t) < CROWDED_S
    return np.asarray(np.isfinite(hard) & ((near & (hard > hard[:, None])).sum(axis=1) >= MAX_CROWDED))


def _contact_point(timeline: BallTimeline, fit: Fit, event: int) -> FloatArray:
    """Return the point where two surfaces touch (2,) m: between balls, at the cushion; else the ball's centre."""
    events, radius = fit.events, timeline.scene.table.ball_radius
    xy: FloatArray = events.xy[event]
    normal = np.zeros(2)
    if events.kind[event] == "cushion":
        normal = np.array(CUSHION_NORMALS.get(events.b[event], (0.0, 0.0)))
    if events.kind[event] == "ball" and events.b[event] in fit.trajectory.ids:
        other = timeline.state_at(events.t[[event]]).xy[0, fit.trajectory.ids.index(events.b[event])]
        away = other - xy
        if np.isfinite(away).all() and np.linalg.norm(away) > 0:
            normal = away / np.linalg.norm(away)
    return np.asarray(xy + radius * normal, dtype=np.float64)
