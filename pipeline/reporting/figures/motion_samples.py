"""The fitted motion at evenly spaced times, for plots and paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.trajectory import State, Trajectory
from models.core.typing import FloatArray
from video.overlay.motion_marks import LEAST_WAY_RADII

ROLLING_SHARE = 2 / 5
"""Of the kinetic energy of its centre, what a solid ball that rolls has besides, in its spin."""


def moments(motion: Trajectory, hz: float) -> FloatArray:
    """Times (K,) s from the first piece to the last; none where nothing is known."""
    if not len(motion.start):
        return np.empty(0)
    first, last = float(motion.start.min()), float(motion.end.max())
    return np.linspace(first, last, max(2, round((last - first) * hz) + 1))


def sample_motion(motion: Trajectory, hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (K,) s, places (K, N, 2) m and speeds (K, N) m/s from the first piece to the last."""
    t = moments(motion, hz)
    state = motion.at(t)
    return t, state.xy, np.linalg.norm(state.v, axis=-1)


def kinetic_energy(state: State, table: Table) -> FloatArray:
    """(..., N) J of motion and of spin about horizontal axes: a ball whose spin is not known is taken to roll.

    Side spin is left out: no picture tells it.
    """
    mass, radius = table.ball_mass, table.ball_radius
    centre = 0.5 * mass * np.sum(state.v**2, axis=-1)
    spin = 0.5 * ROLLING_SHARE * mass * radius**2 * np.sum(state.w[..., :2] ** 2, axis=-1)
    return np.asarray(centre + np.where(np.isfinite(spin), spin, ROLLING_SHARE * centre))


def ever_moves(xy: FloatArray, ball_radius: float) -> NDArray[np.bool_]:
    """Which balls (N,) get away from where they began, of the places `xy` (K, N, 2) m: those that the video names."""
    moves = np.zeros(xy.shape[1], dtype=bool)
    for ball in range(xy.shape[1]):
        known = xy[np.isfinite(xy[:, ball, 0]), ball]
        moves[ball] = len(known) and np.linalg.norm(known - known[0], axis=1).max() > LEAST_WAY_RADII * ball_radius
    return moves


def few_points(line: FloatArray, tolerance: float) -> NDArray[np.intp]:
    """Indices of the points of a line (n, 2) that it needs so as to stay within `tolerance` (Ramer 1972)."""
    keep = np.zeros(len(line), dtype=bool)
    spans = [(0, len(line) - 1)] if len(line) else []
    while spans:
        first, last = spans.pop()
        keep[[first, last]] = True
        away = _off_chord(line[first : last + 1])
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            spans += [(first, first + worst), (first + worst, last)]
    return np.flatnonzero(keep)


def _off_chord(line: FloatArray) -> FloatArray:
    """How far each point (n, 2) lies from the straight way between the first and the last."""
    chord, from_first = line[-1] - line[0], line - line[0]
    length = float(chord @ chord)
    share = np.clip(from_first @ chord / length, 0.0, 1.0) if length > 0 else np.zeros(len(line))
    return np.asarray(np.linalg.norm(from_first - share[:, None] * chord, axis=1))
