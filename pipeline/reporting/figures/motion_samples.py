"""Sampled motion for plots and paths: energies, which balls move, and lines of few points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.trajectory import State
from models.core.typing import FloatArray
from video.overlay.motion_paths import MIN_TRAVEL_RADII

# Rotational energy of a rolling solid ball, relative to its translational energy.
ROLLING_ENERGY_RATIO = 2 / 5


def kinetic_energy(state: State, table: Table) -> FloatArray:
    """Compute the kinetic energy of translation and of spin about horizontal axes.

    Args:
        state: State of N balls; a ball of unknown spin is assumed to roll.
        table: Mass and radius of the balls.

    Returns:
        (..., N) J. Side spin is not included, because it is not observable in images.
    """
    mass, radius = table.ball_mass, table.ball_radius
    centre = 0.5 * mass * np.sum(state.v**2, axis=-1)
    spin = 0.5 * ROLLING_ENERGY_RATIO * mass * radius**2 * np.sum(state.w[..., :2] ** 2, axis=-1)
    return np.asarray(centre + np.where(np.isfinite(spin), spin, ROLLING_ENERGY_RATIO * centre))


def find_moving_balls(xy: FloatArray, ball_radius: float) -> NDArray[np.bool_]:
    """Find the balls that leave their initial positions; the video shows their names.

    Args:
        xy: Positions (K, N, 2) m, NaN where unknown.
        ball_radius: m.

    Returns:
        (N,) whether each ball moves.
    """
    if not len(xy):
        return np.zeros(xy.shape[1], dtype=bool)
    first = xy[np.isfinite(xy[..., 0]).argmax(axis=0), np.arange(xy.shape[1])]
    travel = np.nanmax(np.linalg.norm(xy - first, axis=-1), axis=0, initial=0.0)
    return np.asarray(travel > MIN_TRAVEL_RADII * ball_radius)


def simplify_line(line: FloatArray, tolerance: float) -> NDArray[np.intp]:
    """Simplify a polyline by the Ramer-Douglas-Peucker algorithm (Ramer 1972).

    Args:
        line: Points (n, 2).
        tolerance: Largest distance of an omitted point from the simplified line, in the unit of the points.

    Returns:
        Indices of the points that remain.
    """
    keep = np.zeros(len(line), dtype=bool)
    spans = [(0, len(line) - 1)] if len(line) else []
    while spans:
        first, last = spans.pop()
        keep[[first, last]] = True
        away = _distance_from_chord(line[first : last + 1])
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            spans += [(first, first + worst), (first + worst, last)]
    return np.flatnonzero(keep)


def _distance_from_chord(line: FloatArray) -> FloatArray:
    """Compute the distance of each point (n, 2) from the segment between the first and the last point."""
    chord, from_first = line[-1] - line[0], line - line[0]
    length = float(chord @ chord)
    share = np.clip(from_first @ chord / length, 0.0, 1.0) if length > 0 else np.zeros(len(line))
    return np.asarray(np.linalg.norm(from_first - share[:, None] * chord, axis=1))
