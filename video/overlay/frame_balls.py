"""Evaluation of the ball positions, speeds and headings that the overlay of a frame shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.trajectory import State
from models.core.typing import FloatArray
from video.matting.ball_timeline import BallTimeline
from video.overlay.frame_overlay import FrameBalls
from video.overlay.motion_paths import MIN_SPEED


def balls_at_times(timeline: BallTimeline, state: State, t: FloatArray) -> list[FrameBalls]:
    """Evaluate the balls on frames at any times.

    Args:
        timeline: Positions of the balls.
        state: State of the balls (K, N) at the times.
        t: Times (K,), s.

    Returns:
        The balls on each frame.
    """
    rows, share = timeline.locate_times(t)
    after, moved = np.minimum(rows + 1, len(timeline.t) - 1), share[:, None, None]
    centre = timeline.centres_at(t, state.xy)
    interpolated = timeline.centre[rows] * (1 - moved) + timeline.centre[after] * moved
    located = np.isfinite(timeline.centre[rows, :, :1])
    centre = np.where(np.isfinite(centre), centre, np.where(located, interpolated, np.nan))
    speed = np.linalg.norm(state.v, axis=-1)
    moving = (np.nan_to_num(speed) > MIN_SPEED) & timeline.moving[np.minimum(rows, len(timeline.moving) - 1)]
    sure = ~state.measured | timeline.observed[rows] | timeline.observed[after]
    near = np.where(share < 0.5, rows, after)
    radius = np.where(np.isfinite(timeline.radius[near]), timeline.radius[near], timeline.radius[rows])
    shown_speed = np.where(moving | ~np.isfinite(speed), speed, 0.0)  # NaN where unknown, as in a pocket
    heading = _motion_headings(timeline, state, t, moving)
    columns = (centre, radius, shown_speed, heading, moving, state.measured, sure)
    return [FrameBalls(*row) for row in zip(*columns, strict=True)]


def _motion_headings(timeline: BallTimeline, state: State, t: FloatArray, moving: NDArray[np.bool_]) -> FloatArray:
    """Return unit vectors of the motion (K, N, 2), px; 0 at rest."""
    ahead = timeline.project(state.xy + 0.01 * state.v, t) - timeline.project(state.xy, t)
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    return np.nan_to_num(np.where(moving[..., None] & (length > 1e-6), ahead / np.maximum(length, 1e-6), 0.0))
