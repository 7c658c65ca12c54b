"""Initial positions and velocities of balls, and the start rows of shots, from positions alone."""

from __future__ import annotations

import numpy as np

from models.core.typing import BoolArray, FloatArray

# Frames that an initial velocity is estimated from, at most.
_MAX_ROWS = 12
# Frames from which a parabola is fitted instead of a line.
_MIN_PARABOLA_ROWS = 6
# chi2 per degree of freedom up to which one smooth path explains a ball's positions.
_MAX_CHI2 = 3.0
# Decrease of chi2 by which a velocity must improve on a constant position.
_MIN_MOTION_CHI2 = 20.0
# Frames on either side that decide whether a ball moves.
_ROWS_PER_SIDE = 3
# Standard deviations by which a ball must have moved.
_SIGNIFICANT_SIGMAS = 6.0
# m: position of a ball that was never observed; there it touches nothing.
UNSEEN_POSITION = 1000.0


def estimate_initial_states(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Estimate the positions and velocities of all balls at the first time.

    Args:
        t: (T,) s, increasing.
        xy: (T, N, 2) m, NaN where a ball was not observed.
        sigma: (T, N) m, standard deviation per axis.

    Returns:
        States (N, 7) at t[0] without slip and spin, and (N,) which balls move.
    """
    start, moving = np.zeros((xy.shape[1], 7)), np.zeros(xy.shape[1], bool)
    for ball in range(len(start)):
        rows = np.flatnonzero(np.isfinite(xy[:, ball, 0]))[:_MAX_ROWS]
        if len(rows) == 0:
            start[ball, 0] = UNSEEN_POSITION * (1 + ball)
            continue
        start[ball, :4], moving[ball] = _estimate_ball_state(t[rows] - t[0], xy[rows, ball], sigma[rows, ball])
    return start, moving


def _estimate_ball_state(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, bool]:
    """Estimate position and velocity (4,) at t = 0, from as many frames as one smooth path explains."""
    for count in range(len(t), 1, -1):
        degree = 2 if count >= _MIN_PARABOLA_ROWS else 1
        curve, chi2 = _fit_polynomial(t[:count], xy[:count], sigma[:count], degree)
        if chi2 <= _MAX_CHI2 * max(2 * (count - degree - 1), 1) or count == 2:
            break
    else:
        return np.concatenate([xy[0], np.zeros(2)]), False
    place, still = _fit_polynomial(t[:count], xy[:count], sigma[:count], 0)
    _, straight = _fit_polynomial(t[:count], xy[:count], sigma[:count], 1)
    if still - straight < _MIN_MOTION_CHI2:
        return np.concatenate([place[0], np.zeros(2)]), False
    return np.concatenate([curve[0], curve[1]]), True


def _fit_polynomial(t: FloatArray, xy: FloatArray, sigma: FloatArray, degree: int) -> tuple[FloatArray, float]:
    """Fit coefficients (degree + 1, 2) of powers of t; return them and chi2."""
    design = np.vander(t, degree + 1, increasing=True) / sigma[:, None]
    curve = np.linalg.lstsq(design, xy / sigma[:, None], rcond=None)[0]
    return np.asarray(curve, np.float64), float(np.square(design @ curve - xy / sigma[:, None]).sum())


def detect_motion(xy: FloatArray, sigma: FloatArray) -> BoolArray:
    """Detect the frames in which any ball moves.

    Args:
        xy: (T, N, 2) m, NaN where a ball was not observed.
        sigma: (T, N) m, standard deviation per axis.

    Returns:
        (T,) True where a ball moves significantly.
    """
    moving = np.zeros(len(xy), bool)
    for ball in range(xy.shape[1]):
        rows = np.flatnonzero(np.isfinite(xy[:, ball, 0]))
        if len(rows) < 2 * _ROWS_PER_SIDE:
            continue
        near = np.lib.stride_tricks.sliding_window_view(xy[rows, ball], 2 * _ROWS_PER_SIDE, axis=0)  # (M, 2, 6)
        way = np.linalg.norm(near[..., _ROWS_PER_SIDE:].mean(axis=2) - near[..., :_ROWS_PER_SIDE].mean(axis=2), axis=1)
        error = np.median(sigma[rows, ball]) * np.sqrt(2 / _ROWS_PER_SIDE)
        for k in np.flatnonzero(way > _SIGNIFICANT_SIGMAS * error):
            moving[rows[k] : rows[k + 2 * _ROWS_PER_SIDE - 1] + 1] = True
    return moving


def find_shot_rows(xy: FloatArray, sigma: FloatArray) -> list[tuple[int, int]]:
    """Find the rows of every shot: from a strike to the next one.

    Args:
        xy: (T, N, 2) m, NaN where a ball was not observed.
        sigma: (T, N) m, standard deviation per axis.

    Returns:
        First row and the row after the last one of each shot.
    """
    moving = detect_motion(xy, sigma)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving]).astype(int)) == 1)
    ranges = []
    for k, first in enumerate(edges):
        last = int(edges[k + 1]) if k + 1 < len(edges) else len(xy)
        ranges.append((_find_departure(xy, sigma, int(first)) if first else 0, last))
    return [(first, last) for first, last in ranges if last > first]


def _find_departure(xy: FloatArray, sigma: FloatArray, first: int) -> int:
    """Find the first row, from `first` on, in which a ball has clearly left its position."""
    before = xy[max(first - _ROWS_PER_SIDE, 0) : first + 1]
    place = np.array([_median_position(before[:, ball]) for ball in range(xy.shape[1])])
    for row in range(first + 1, min(first + 2 * _ROWS_PER_SIDE + 1, len(xy))):
        way = np.linalg.norm(xy[row] - place, axis=1)
        if np.any(way > _SIGNIFICANT_SIGMAS * sigma[row]):
            return row
    return first


def _median_position(places: FloatArray) -> FloatArray:
    """Compute the median (2,) of the observed positions (M, 2); NaN where there is none."""
    observed = places[np.isfinite(places[:, 0])]
    return np.asarray(np.median(observed, axis=0)) if len(observed) else np.full(2, np.nan)
