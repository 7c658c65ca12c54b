"""Balls that start or turn without a listed event."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.stress_cases.stress_chain import FittedShot, find_marks
from models.core.typing import FloatArray

# A ball starts from below the first to above the second speed; it can turn above the third, m/s.
REST_SPEED, START_SPEED, TURN_SPEED = 0.02, 0.1, 0.2
# Least turn, rad.
TURN = np.radians(20.0)
# Acceleration of a sliding ball at most, m/s2: what turns a ball no faster needs no cause.
FRICTION = 3.0
# Time in which a ball starts or turns, also the largest distance of its cause, and the steps in which it is sought.
SPAN_FRAMES, STEPS_PER_FRAME = 1.5, 4
# An event below this probability is no cause.
LEAST_PROBABILITY = 0.1


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """A start or turn of a ball at a frame, whether a listed event causes it, and whether it is marked otherwise."""

    ball: str
    kind: str
    frame: float
    caused: bool
    marked: bool


def find_speed_changes(shot: FittedShot) -> list[SpeedChange]:
    """Find where the fitted path of a ball starts or turns.

    Args:
        shot: Tracks and fit.

    Returns:
        The changes, in order of ball and time.
    """
    tracks, events, ids = shot.tracks, shot.fit.events, shot.tracks.ids
    frame_s = float(np.median(np.diff(tracks.t)))
    step = frame_s / STEPS_PER_FRAME
    reach = round(SPAN_FRAMES * STEPS_PER_FRAME)
    t = np.arange(tracks.t[0], tracks.t[-1], step)
    if len(t) <= reach:
        return []
    v = shot.fit.trajectory.at(t).v
    before, after, middle = v[:-reach], v[reach:], t[: len(t) - reach] + reach * step / 2
    slow, fast = np.linalg.norm(before, axis=2), np.linalg.norm(after, axis=2)
    starts = (slow < REST_SPEED) & (fast > START_SPEED)
    turns = (slow > TURN_SPEED) & (fast > TURN_SPEED) & (measure_angles(before, after) > TURN)
    turns &= np.linalg.norm(after - before, axis=2) > FRICTION * reach * step
    marks = find_marks(shot.fit)
    changes = []
    for k, ball in enumerate(ids):
        causes = [
            float(events.t[e])
            for e in range(len(events))
            if ball in (events.a[e], events.b[e])
            and events.kind[e] != "rest"
            and events.probability[e] >= LEAST_PROBABILITY
        ]
        marked_times = [time for name, time in marks if name == ball]
        for kind, flags in (("starts", starts[:, k]), ("turns", turns[:, k])):
            for times in _split_runs(middle, flags, step):
                near = [_is_near(times, causes, SPAN_FRAMES * frame_s) for times in times]
                open_times = times[~np.array(near)]
                at = float(np.median(open_times if len(open_times) else times))
                marked = bool(len(open_times)) and _is_near(at, marked_times, SPAN_FRAMES * frame_s + 0.005)
                frame = float(np.interp(at, tracks.t, tracks.frame))
                changes.append(SpeedChange(ball, kind, frame, not len(open_times), marked))
    return changes


def measure_angles(one: FloatArray, other: FloatArray) -> FloatArray:
    """Measure the angles (...) between vectors (..., 2), rad; NaN where one is unknown."""
    cross = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return np.asarray(np.abs(np.arctan2(cross, (one * other).sum(axis=-1))))


def _split_runs(t: FloatArray, flags: FloatArray, step: float) -> list[FloatArray]:
    """Split the flagged times into runs of neighbours."""
    rows = np.flatnonzero(flags)
    if not len(rows):
        return []
    return list(np.split(t[rows], np.flatnonzero(np.diff(rows) > 1) + 1))


def _is_near(t: float, times: list[float], reach: float) -> bool:
    return any(abs(t - time) <= reach for time in times)
