"""The fitted motion at evenly spaced times, for plots and paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.trajectory import Trajectory
from video.motion_marks import LEAST_WAY_RADII

Floats = NDArray[np.float64]


def sample_motion(motion: Trajectory, hz: float) -> tuple[Floats, Floats, Floats]:
    """Times (K,) s, places (K, N, 2) m and speeds (K, N) m/s from the first piece to the last."""
    balls = len(motion.ids)
    if not len(motion.start):
        return np.empty(0), np.empty((0, balls, 2)), np.empty((0, balls))
    first, last = float(motion.start.min()), float(motion.end.max())
    t = np.linspace(first, last, max(2, round((last - first) * hz) + 1))
    state = motion.at(t)
    return t, state.xy, np.linalg.norm(state.v, axis=-1)


def ever_moves(xy: Floats, ball_radius: float) -> NDArray[np.bool_]:
    """Which balls (N,) get away from where they began, of the places `xy` (K, N, 2) m: those that the video names."""
    moves = np.zeros(xy.shape[1], dtype=bool)
    for ball in range(xy.shape[1]):
        known = xy[np.isfinite(xy[:, ball, 0]), ball]
        moves[ball] = len(known) and np.linalg.norm(known - known[0], axis=1).max() > LEAST_WAY_RADII * ball_radius
    return moves
