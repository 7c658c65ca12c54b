"""Regions that hold a share of a probability: of a normal distribution, and of draws from any.

The level of a place is the share of the probability that is denser than there; the region of 90 % holds all places of
a level of at most 0.9, and is the smallest that holds so much (Hyndman 1996, doi:10.1080/00031305.1996.10474359).
Among draws, the distance to the k-th nearest one stands for the density (Loftsgaarden and Quesenberry 1965,
doi:10.1214/aoms/1177700079): it follows several courses at once, and no width has to be chosen.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from models.core.typing import FloatArray

FINEST = 1e-7
"""m: distances below are one place."""
_GOLDEN = np.pi * (3 - np.sqrt(5))
"""rad: turns that spread evenly."""


def level_of_normal(apart: FloatArray, covariance: FloatArray) -> float:
    """Level of a place `apart` (2,) m from the mean of a normal distribution with covariance (2, 2)."""
    known = covariance + FINEST**2 * np.eye(2)
    return float(1 - np.exp(-0.5 * apart @ np.linalg.solve(known, apart)))


def level_by_neighbours(xy: FloatArray, draws: FloatArray, noise: FloatArray | None = None) -> float:
    """Level of `xy` (2,), seen with errors of covariance `noise` (2, 2), among draws (M, 2); NaN below two of them."""
    if len(draws) < 2:
        return float("nan")
    spread = draws
    if noise is not None:
        spread = draws + _normal_pattern(len(draws)) @ np.linalg.cholesky(noise + FINEST**2 * np.eye(2)).T
    far, own = _distances(spread, np.vstack([xy[None], spread]))
    # of as many others as each draw has: its own place is one of its neighbours
    return float(np.mean(own[1:] < far[0]))


def levels_by_neighbours(places: FloatArray, draws: FloatArray) -> FloatArray:
    """Levels (K,) of places (K, 2) among draws (M, 2), M >= 2."""
    far, own = _distances(draws, np.vstack([places, draws]))
    ranked = np.sort(own[len(places) :])
    return np.asarray(np.searchsorted(ranked, far[: len(places)]) / len(draws), np.float64)


def outlyingness(courses: FloatArray) -> FloatArray:
    """Of courses (M, T, 2), NaN where one has ended: the share (M,) of them that stay nearer to the middle.

    The level of a place, averaged over a course; the courses of up to 0.9 are the 90 % that go with most others.
    """
    levels = np.full(courses.shape[:2], np.nan)
    for row in range(courses.shape[1]):
        there = np.isfinite(courses[:, row, 0])
        if there.sum() > 1:
            levels[there, row] = levels_by_neighbours(courses[there, row], courses[there, row])
    seen = np.isfinite(levels)
    mean = np.where(seen, levels, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return np.asarray((np.argsort(np.argsort(mean, kind="stable"), kind="stable") + 0.5) / len(mean), np.float64)


def _distances(draws: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of places (K, 2): distance to the k-th nearest draw, and to the next one, for places that are draws; k is the
    root of the number of draws."""
    k = min(max(round(np.sqrt(len(draws))), 1), len(draws) - 1)
    found, _ = cKDTree(draws).query(places, k=[k, k + 1])
    return found[:, 0] + FINEST, found[:, 1] + FINEST


def _normal_pattern(count: int) -> FloatArray:
    """(M, 2) points that lie as a standard normal distribution does, in an order that goes with nothing."""
    k = np.arange(count)
    radius = np.sqrt(-2 * np.log((np.random.default_rng(0).permutation(count) + 0.5) / count))
    return np.column_stack([radius * np.cos(_GOLDEN * k), radius * np.sin(_GOLDEN * k)])
