"""Where shots begin, and with what places and velocities, from what was seen alone."""

from __future__ import annotations

import numpy as np

from models.core.typing import BoolArray, FloatArray

_ROWS = 12
"""pictures that a first velocity is taken from, at most."""
_BENT = 6
"""pictures from which on a path may be bent."""
_FITS = 3.0
"""chi2 per degree of freedom up to which a ball was left alone."""
_MOVES = 20.0
"""chi2 by which a velocity must explain more than a place."""
_SIDE = 3
"""pictures on either side that tell whether a ball moves."""
_CLEAR = 6.0
"""standard deviations that a ball must have moved."""
AWAY = 1000.0
"""m: there a ball lies that was never seen, and meets nothing."""


def beginning(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(N, 7) places and velocities at t[0] of balls seen at xy (T, N, 2) with errors (T, N), without spin; (N,) which
    of them move."""
    start, moving = np.zeros((xy.shape[1], 7)), np.zeros(xy.shape[1], bool)
    for ball in range(len(start)):
        rows = np.flatnonzero(np.isfinite(xy[:, ball, 0]))[:_ROWS]
        if len(rows) == 0:
            start[ball, 0] = AWAY * (1 + ball)
            continue
        start[ball, :4], moving[ball] = _of_ball(t[rows] - t[0], xy[rows, ball], sigma[rows, ball])
    return start, moving


def _of_ball(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, bool]:
    """(4,) place and velocity at t = 0, from as many pictures as one smooth path explains."""
    for count in range(len(t), 1, -1):
        degree = 2 if count >= _BENT else 1
        curve, chi2 = _path(t[:count], xy[:count], sigma[:count], degree)
        if chi2 <= _FITS * max(2 * (count - degree - 1), 1) or count == 2:
            break
    else:
        return np.concatenate([xy[0], np.zeros(2)]), False
    place, still = _path(t[:count], xy[:count], sigma[:count], 0)
    _, straight = _path(t[:count], xy[:count], sigma[:count], 1)
    if still - straight < _MOVES:
        return np.concatenate([place[0], np.zeros(2)]), False
    return np.concatenate([curve[0], curve[1]]), True


def _path(t: FloatArray, xy: FloatArray, sigma: FloatArray, degree: int) -> tuple[FloatArray, float]:
    """Coefficients (degree + 1, 2) of powers of t, and chi2."""
    design = np.vander(t, degree + 1, increasing=True) / sigma[:, None]
    curve = np.linalg.lstsq(design, xy / sigma[:, None], rcond=None)[0]
    return np.asarray(curve, np.float64), float(np.square(design @ curve - xy / sigma[:, None]).sum())


def moves(xy: FloatArray, sigma: FloatArray) -> BoolArray:
    """(T,) whether any of the balls seen at xy (T, N, 2) moves there."""
    found = np.zeros(len(xy), bool)
    for ball in range(xy.shape[1]):
        rows = np.flatnonzero(np.isfinite(xy[:, ball, 0]))
        if len(rows) < 2 * _SIDE:
            continue
        near = np.lib.stride_tricks.sliding_window_view(xy[rows, ball], 2 * _SIDE, axis=0)  # (M, 2, 6)
        way = np.linalg.norm(near[..., _SIDE:].mean(axis=2) - near[..., :_SIDE].mean(axis=2), axis=1)
        error = np.median(sigma[rows, ball]) * np.sqrt(2 / _SIDE)
        for k in np.flatnonzero(way > _CLEAR * error):
            found[rows[k] : rows[k + 2 * _SIDE - 1] + 1] = True
    return found


def strikes(xy: FloatArray, sigma: FloatArray) -> list[tuple[int, int]]:
    """First row, and the row after the last one, of every stretch in which balls move after a strike."""
    moving = moves(xy, sigma)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving]).astype(int)) == 1)
    found = []
    for k, first in enumerate(edges):
        last = int(edges[k + 1]) if k + 1 < len(edges) else len(xy)
        found.append((_moved(xy, sigma, int(first)) if first else 0, last))
    return [(first, last) for first, last in found if last > first]


def _moved(xy: FloatArray, sigma: FloatArray, first: int) -> int:
    """The first row, from `first` on, in which a ball has clearly left its place."""
    before = xy[max(first - _SIDE, 0) : first + 1]
    place = np.array([_middle(before[:, ball]) for ball in range(xy.shape[1])])
    for row in range(first + 1, min(first + 2 * _SIDE + 1, len(xy))):
        way = np.linalg.norm(xy[row] - place, axis=1)
        if np.any(way > _CLEAR * sigma[row]):
            return row
    return first


def _middle(places: FloatArray) -> FloatArray:
    """(2,) median of the places (M, 2) that were seen; NaN where none was."""
    seen = places[np.isfinite(places[:, 0])]
    return np.asarray(np.median(seen, axis=0)) if len(seen) else np.full(2, np.nan)
