"""What a shot's drawing shows of its motion: the way of every ball, and the events that flash."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.fit_result import Fit
from models.core.typing import FloatArray
from video.drawing.palette import FLASH
from video.matting.ball_timeline import Sightings
from video.overlay.frame_overlay import Label, error_text

PATH_STEP = 1 / 240
"""s between points of a path."""
LEAST_SPEED = 2e-3
"""m/s below which a ball counts as resting."""
POINTS_APART = 6.0
"""px between drawn points of a path."""
LEAST_WAY_RADII = 0.4
"""Ball radii that a ball goes at least in a span that is drawn and named: less is noise, or no eye sees it."""
LEAST_PROBABILITY = 0.5
"""Events below are not drawn."""
MOST_SIGMA = 0.05
"""s; an event whose time is less sure is not drawn: it would flash at a wrong moment."""
AT_ONCE, MOST_AT_ONCE = 0.03, 4
"""s, and how many contacts within that are drawn at most."""
BEYOND_RADII = 3.0
"""How far outside the noses, in ball radii, a path is still drawn: pockets, but no run-away fit."""
SURE = 0.9
"""Probability from which an event is drawn without naming it."""
STRENGTHS = {"ball": 1.0, "strike": 0.75, "cushion": 0.65, "pocket": 0.8}
NORMALS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "top": (0.0, -1.0), "bottom": (0.0, 1.0)}


@dataclass(frozen=True, slots=True)
class Path:
    """Where one ball moved: n points in order of time; empty for a ball that rests."""

    t: FloatArray
    """(n,) s"""
    xy: FloatArray
    """(n, 2) m"""
    px: FloatArray
    """(n, 2) reference pixels."""
    spans: FloatArray
    """(k, 2) s, when it moved."""
    radius: float
    """px, of the ball while it moved."""
    drawn: NDArray[np.intp]
    """Indices of the points that a line needs: some px apart, all corners."""


@dataclass(frozen=True, slots=True)
class Mark:
    """An event as it is drawn."""

    t: float
    xy: FloatArray
    """(2,) m, the point of contact."""
    ball: int
    strength: float
    label: Label


def path_of(sightings: Sightings, fit: Fit, ball: int) -> Path:
    """Sample one ball's motion while it moves, corners at events included."""
    rows, spans = _journeys(sightings, ball)
    if not len(rows):
        none = np.empty((0, 2))
        return Path(np.empty(0), none, none, none, 0.0, np.empty(0, dtype=np.intp))
    spans = _trimmed(spans, fit, ball)
    parts = [np.arange(start, end, PATH_STEP) for start, end in spans]
    inside = [t for t in fit.events.t if ((spans[:, 0] <= t) & (t <= spans[:, 1])).any()]
    times = np.unique(np.concatenate([*parts, spans.ravel(), np.array(inside)]))
    xy = fit.trajectory.at(times).xy[:, ball]
    table, beyond = sightings.scene.table, BEYOND_RADII * sightings.scene.table.ball_radius
    known = ((xy > -beyond) & (xy < np.array([table.length, table.width]) + beyond)).all(axis=1)
    radii = sightings.radius[rows, ball]
    radius = float(np.median(radii[np.isfinite(radii)])) if np.isfinite(radii).any() else 8.0
    times, xy = times[known], xy[known]
    px = sightings.scene.camera.to_pixels(xy, table.ball_radius)
    drawn = spaced(sightings.shown(px, float(sightings.t[0])), np.isin(times, inside))
    return Path(times, xy, px, spans, radius, drawn)


def _journeys(sightings: Sightings, ball: int) -> tuple[NDArray[np.intp], FloatArray]:
    """Pictures (n,) and spans (k, 2) s in which a ball gets somewhere: rests and jitter left out."""
    rows = np.flatnonzero(sightings.moves[:, ball])
    runs = [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if _goes(sightings, ball, run)]
    spans = [[sightings.t[run[0]], sightings.t[run[-1] + 1]] for run in runs]
    return np.concatenate([np.empty(0, dtype=np.intp), *runs]), np.array(spans).reshape(-1, 2)


def _goes(sightings: Sightings, ball: int, rows: NDArray[np.intp]) -> bool:
    """Whether a ball is ever `LEAST_WAY_RADII` from where it was at the first of these neighbouring pictures."""
    if not len(rows):
        return False
    stay = slice(rows[0], rows[-1] + 2)
    away = np.linalg.norm(sightings.centre[stay, ball] - sightings.centre[rows[0], ball], axis=1)
    way = away / sightings.radius[stay, ball]
    return bool(np.any(~np.isfinite(way)) or way.max() > LEAST_WAY_RADII)


def _trimmed(spans: FloatArray, fit: Fit, ball: int) -> FloatArray:
    """Spans (k, 2) s between pictures, begun and ended where the ball really does."""
    exact = spans.copy()
    for k, (start, end) in enumerate(spans):
        times = np.arange(start, end, PATH_STEP)
        speed = np.linalg.norm(fit.trajectory.at(times).v[:, ball], axis=1)
        moving = np.flatnonzero(speed > LEAST_SPEED)
        if len(moving):
            exact[k] = times[moving[0]], min(times[moving[-1]] + PATH_STEP, end)
    return exact


def spaced(px: FloatArray, corner: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Indices of points (n, 2) px at least `POINTS_APART` apart along the way, and of all corners (n,)."""
    if not len(px):
        return np.empty(0, dtype=np.intp)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(px, axis=0), axis=1))]) / POINTS_APART
    keep = corner | np.concatenate([[True], np.diff(np.floor(way)) > 0])
    keep[-1] = True
    return np.flatnonzero(keep)


def marks_of(sightings: Sightings, fit: Fit) -> tuple[Mark, ...]:
    """The events that are drawn: all but rests, and those that are likelier than not; of many at once the hardest."""
    events = fit.events
    crowded = _crowded_out(events)
    marks = []
    for k, kind in enumerate(events.kind):
        known = events.probability[k] >= LEAST_PROBABILITY and events.t_sigma[k] <= MOST_SIGMA
        if kind not in STRENGTHS or not known or crowded[k] or events.a[k] not in fit.trajectory.ids:
            continue
        ball = fit.trajectory.ids.index(events.a[k])
        xy = _contact_point(sightings, fit, k)
        doubt = "" if events.probability[k] >= SURE else f"  ({events.probability[k]:.0%})"
        value = f"{events.t[k]:.3f} s {error_text(float(events.t_sigma[k]))}{doubt}"
        title = {"ball": f"{events.a[k]} – {events.b[k]}", "cushion": f"{events.a[k]} – cushion"}.get(kind, kind)
        if np.isfinite(xy).all():
            marks.append(Mark(float(events.t[k]), xy, ball, STRENGTHS[kind], Label(title, value, FLASH)))
    return tuple(marks)


def _crowded_out(events: Events) -> NDArray[np.bool_]:
    """(E,) contacts of balls beside which `MOST_AT_ONCE` harder ones happen: all of a break's would be a tangle."""
    hard = np.where([kind == "ball" for kind in events.kind], np.nan_to_num(events.speed), -np.inf)
    near = np.abs(events.t[:, None] - events.t) < AT_ONCE
    return np.asarray(np.isfinite(hard) & ((near & (hard > hard[:, None])).sum(axis=1) >= MOST_AT_ONCE))


def _contact_point(sightings: Sightings, fit: Fit, event: int) -> FloatArray:
    """Where two surfaces meet (2,) m: between the balls, at the cushion; else the ball's centre."""
    events, radius = fit.events, sightings.scene.table.ball_radius
    xy: FloatArray = events.xy[event]
    normal = np.zeros(2)
    if events.kind[event] == "cushion":
        normal = np.array(NORMALS.get(events.b[event], (0.0, 0.0)))
    if events.kind[event] == "ball" and events.b[event] in fit.trajectory.ids:
        other = sightings.state(events.t[[event]]).xy[0, fit.trajectory.ids.index(events.b[event])]
        away = other - xy
        if np.isfinite(away).all() and np.linalg.norm(away) > 0:
            normal = away / np.linalg.norm(away)
    return np.asarray(xy + radius * normal, dtype=np.float64)
