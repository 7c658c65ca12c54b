"""Probability regions of a normal distribution and of an ensemble.

The level of a place is the share of the probability that is denser than there; the region of 90 % holds all places of a
level of at most 0.9, and is the smallest of this probability (Hyndman 1996, doi:10.1080/00031305.1996.10474359). In an
ensemble, the distance to the k-th nearest member stands for the density (Loftsgaarden and Quesenberry 1965,
doi:10.1214/aoms/1177700079): it follows several branches at once, and needs no bandwidth.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from models.core.typing import FloatArray

MIN_DISTANCE = 1e-7
"""m: smaller distances count as one place."""
_GOLDEN = np.pi * (3 - np.sqrt(5))
"""rad: golden angle, which spreads points evenly."""


def level_of_normal(offset: FloatArray, covariance: FloatArray) -> float:
    """Return the level of a place `offset` (2,) m from the mean of a normal distribution with covariance (2, 2)."""
    regularized = covariance + MIN_DISTANCE**2 * np.eye(2)
    return float(1 - np.exp(-0.5 * offset @ np.linalg.solve(regularized, offset)))


def level_by_neighbours(xy: FloatArray, draws: FloatArray, noise: FloatArray | None = None) -> float:
    """Return the level of `xy` (2,), with error covariance `noise` (2, 2), among draws (M, 2); NaN below two."""
    if len(draws) < 2:
        return float("nan")
    spread = draws
    if noise is not None:
        spread = draws + _normal_pattern(len(draws)) @ np.linalg.cholesky(noise + MIN_DISTANCE**2 * np.eye(2)).T
    far, own = _neighbour_distances(spread, np.vstack([xy[None], spread]))
    # each draw counts itself as one of its neighbours, so its next distance is compared
    return float(np.mean(own[1:] < far[0]))


def _neighbour_distances(draws: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances of places (K, 2) to the k-th nearest draw, and to the next one, for places that are draws.

    k is the square root of the number of draws.
    """
    k = min(max(round(np.sqrt(len(draws))), 1), len(draws) - 1)
    distances, _ = cKDTree(draws).query(places, k=[k, k + 1])
    return distances[:, 0] + MIN_DISTANCE, distances[:, 1] + MIN_DISTANCE


def _normal_pattern(count: int) -> FloatArray:
    """Return (M, 2) quasi-random points of a standard normal distribution, in random order."""
    k = np.arange(count)
    radius = np.sqrt(-2 * np.log((np.random.default_rng(0).permutation(count) + 0.5) / count))
    return np.column_stack([radius * np.cos(_GOLDEN * k), radius * np.sin(_GOLDEN * k)])
