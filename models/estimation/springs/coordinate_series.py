"""Coordinates of particles through time as they were measured, and what they say before any model is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import BoolArray, FloatArray
from models.estimation.springs.parameter_layout import Units

LEAST_SAMPLES = 8
STILL = 0.02
"""share of the widest motion within which a particle may be held in place."""
WANDERING = 0.5
"""correlation of neighbouring samples from which a particle wanders and is not held."""
EXACT = 1e-6
"""of the typical distance: errors are not taken to be smaller."""


@dataclass(frozen=True, slots=True)
class Coordinates:
    """N particles at T times in D axes; NaN where one was not seen."""

    t: FloatArray
    """(T,) s, growing."""
    x: FloatArray
    """(T, N, D)"""
    sigma: float | None = None
    """standard deviation of every coordinate, where it is known."""

    def __post_init__(self) -> None:
        if self.x.ndim != 3 or len(self.t) != len(self.x):
            raise ValueError(f"coordinates are (T, N, D) at t (T,); got {self.x.shape} at {self.t.shape}")
        if len(self.t) < LEAST_SAMPLES:
            raise ValueError(f"{len(self.t)} samples; a motion needs at least {LEAST_SAMPLES}")
        if np.any(np.diff(self.t) <= 0):
            raise ValueError("times must grow")
        if np.any(np.isfinite(self.x).all(axis=2).sum(axis=0) < LEAST_SAMPLES):
            raise ValueError(f"every particle must be seen at least {LEAST_SAMPLES} times")

    def first(self, count: int) -> Coordinates:
        """The first samples alone."""
        return Coordinates(self.t[:count], self.x[:count], self.sigma)


def filled(seen: Coordinates) -> tuple[FloatArray, FloatArray]:
    """Places and velocities (T, N, D) of cubic splines through what was seen: first guesses."""
    x, v = np.empty_like(seen.x), np.empty_like(seen.x)
    for i, axis in np.ndindex(seen.x.shape[1:]):
        there = np.isfinite(seen.x[:, i, axis])
        curve = CubicSpline(seen.t[there], seen.x[there, i, axis])
        inside = np.clip(seen.t, seen.t[there][0], seen.t[there][-1])
        x[:, i, axis], v[:, i, axis] = curve(inside), curve(inside, 1)
    return x, v


def held(seen: Coordinates) -> BoolArray:
    """(N,) True where a particle stays in place and only its measurement errs."""
    middle = np.nanmean(seen.x, axis=0)
    off = np.nan_to_num(seen.x - middle)
    spread = np.sqrt((off**2).mean(axis=(0, 2)))
    wander = (off[1:] * off[:-1]).sum(axis=(0, 2)) / np.maximum((off**2).sum(axis=(0, 2)), 1e-300)
    return np.asarray((spread < STILL * spread.max()) & (wander < WANDERING), np.bool_)


def noise(seen: Coordinates, still: BoolArray) -> float | None:
    """Standard deviation of a coordinate: as told, else that of particles that are held, else unknown."""
    least = EXACT * units(seen).length
    if seen.sigma is not None:
        return max(seen.sigma, least)
    if not np.any(still):
        return None
    off = seen.x[:, still] - np.nanmean(seen.x[:, still], axis=0)
    there = int(np.isfinite(off).sum())
    return max(float(np.sqrt(np.nansum(off**2) / (there - off[0].size))), least)


def units(seen: Coordinates) -> Units:
    """Typical distance, time between samples, acceleration."""
    x, _ = filled(seen)
    i, j = np.array(list(combinations(range(x.shape[1]), 2)) or [(0, 0)]).T
    apart = np.linalg.norm(x[:, i] - x[:, j], axis=2)
    span = float(np.median(np.diff(seen.t)))
    length = float(np.median(apart)) or float(np.ptp(x, axis=0).max())
    return Units(length, span, bend(seen) / span**2)


def bend(seen: Coordinates) -> float:
    """How far samples lie from the middle of their neighbours, root mean square, times two."""
    return float(np.sqrt(np.nanmean(np.diff(seen.x, 2, axis=0) ** 2)))


def steadiness(seen: Coordinates) -> tuple[list[tuple[int, int]], FloatArray, FloatArray]:
    """All pairs, their median distances, and how much these vary, relative; of distances that hardly vary first."""
    pairs = list(combinations(range(seen.x.shape[1]), 2))
    if not pairs:
        return [], np.empty(0), np.empty(0)
    i, j = np.array(pairs).T
    apart = np.linalg.norm(seen.x[:, j] - seen.x[:, i], axis=2)
    vary = np.nanstd(apart, axis=0) / np.nanmean(apart, axis=0)
    order = np.argsort(vary)
    return [pairs[k] for k in order], np.nanmedian(apart, axis=0)[order], vary[order]
