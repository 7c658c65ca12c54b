"""Motion that no hypothesis explains: every start and turn of a ball has a cause, or is marked as unexplained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.fit_result import CauseHypothesis, Moment, ShotExplanation
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory

# Frames over which a velocity changes, also the largest distance of its cause; and the steps in which it is sought.
SPAN_FRAMES, STEPS_PER_FRAME = 1.5, 4
# Frames and s before the end of the clip from which a ball that is no longer detected has vanished.
VANISH_FRAMES, VANISH_TIME = 5, 0.3
# m/s^2: no cloth changes a velocity faster (sliding friction is about 2).
FRICTION_LIMIT = 3.0
# m/s: smaller changes, and changes of slower balls, are within the errors of a path.
MIN_CHANGE, MIN_SPEED = 0.08, 0.1


def mark_unexplained_motion(explanation: ShotExplanation, trajectory: Trajectory, tracks: Tracks) -> ShotExplanation:
    """Add an unexplained moment wherever a ball starts or turns and no moment is near.

    Args:
        explanation: Explanation of the shot.
        trajectory: Motion of N balls.
        tracks: Tracks of N balls over T frames.

    Returns:
        The explanation with these moments.
    """
    if len(tracks.t) < 2:
        return explanation
    frame = float(np.median(np.diff(tracks.t)))
    step, reach = frame / STEPS_PER_FRAME, round(SPAN_FRAMES * STEPS_PER_FRAME)
    t = np.arange(tracks.t[0], tracks.t[-1], step)
    if len(t) <= reach:
        return explanation
    state = trajectory.at(t)
    change = np.linalg.norm(state.v[reach:] - state.v[:-reach], axis=2)
    fastest = np.maximum(np.linalg.norm(state.v[reach:], axis=2), np.linalg.norm(state.v[:-reach], axis=2))
    is_abrupt = (change > FRICTION_LIMIT * reach * step + MIN_CHANGE) & (fastest > MIN_SPEED)
    moments = list(explanation.moments)
    for k, ball in enumerate(tracks.ids):
        causes = np.array([one.t for one in explanation.moments if ball in _list_balls(one)])
        abrupt = np.flatnonzero(is_abrupt[:, k])
        for rows in np.split(abrupt, np.flatnonzero(np.diff(abrupt) > 1) + 1):  # runs of neighbours
            middle = t[rows] + reach * step / 2
            if len(causes):
                middle = middle[np.abs(middle[:, None] - causes).min(axis=1) > SPAN_FRAMES * frame]
            middle = middle[[not explanation.is_due_to_break(float(one), ball) for one in middle]]
            if len(middle):
                at = float(np.median(middle))
                xy = np.array([np.interp(at, t, state.xy[:, k, axis]) for axis in (0, 1)])
                unexplained = (CauseHypothesis("unexplained", "", 1.0),)
                moments.append(Moment(ball, at, frame / 2, xy, unexplained, ("no_cause",)))
    moments += _find_vanished_balls(explanation, trajectory, tracks, frame)
    return replace(explanation, moments=tuple(sorted(moments, key=lambda one: one.t)))


def _find_vanished_balls(
    explanation: ShotExplanation, trajectory: Trajectory, tracks: Tracks, frame: float
) -> list[Moment]:
    """Find balls that rest when they are last detected, some time before the clip ends: something took them away."""
    moments = []
    for k, ball in enumerate(tracks.ids):
        rows = np.flatnonzero(tracks.is_observed[:, k])
        if not len(rows) or tracks.t[-1] - tracks.t[rows[-1]] < max(VANISH_FRAMES * frame, VANISH_TIME):
            continue
        last = float(tracks.t[rows[-1]])
        own = [one for one in explanation.moments if ball in _list_balls(one)]
        later = [one for one in own if one.t > last - SPAN_FRAMES * frame or one.best.cause == "pocket"]
        v = trajectory.at(np.array([last])).v[0, k]
        if not later and not np.hypot(*v) > MIN_SPEED:
            unexplained = (CauseHypothesis("unexplained", "", 1.0),)
            xy = tracks.xy[rows[-1], k]
            moments.append(Moment(ball, last + frame / 2, frame / 2, xy, unexplained, ("no_cause",)))
    return moments


def _list_balls(moment: Moment) -> tuple[str, ...]:
    """List the balls whose velocity changes at a moment."""
    others = (one.other for one in moment.hypotheses if one.cause == "ball")
    return () if moment.best.cause == "rest" else (moment.ball, *others)
