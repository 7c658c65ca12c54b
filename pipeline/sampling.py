"""The fitted motion at evenly spaced times, for plots and paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.trajectory import Trajectory

Floats = NDArray[np.float64]

MOVING_SPEED = 1e-3
"""m/s; a ball that never exceeds it rests through the whole clip."""


def sample_motion(motion: Trajectory, hz: float) -> tuple[Floats, Floats, Floats]:
    """Times (K,) s, places (K, N, 2) m and speeds (K, N) m/s from the first piece to the last."""
    balls = len(motion.ids)
    if not len(motion.start):
        return np.empty(0), np.empty((0, balls, 2)), np.empty((0, balls))
    first, last = float(motion.start.min()), float(motion.end.max())
    t = np.linspace(first, last, max(2, round((last - first) * hz) + 1))
    state = motion.at(t)
    return t, state.xy, np.linalg.norm(state.v, axis=-1)


def ever_moves(speed: Floats) -> NDArray[np.bool_]:
    """Which balls (N,) move at any of the times of `speed` (K, N)."""
    moves: NDArray[np.bool_] = np.any(np.nan_to_num(speed) > MOVING_SPEED, axis=0)
    return moves
