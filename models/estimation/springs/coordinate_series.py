"""Measured coordinates of particles, and their statistics before any model is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import BoolArray, FloatArray
from models.estimation.springs.parameter_layout import TypicalScales

MIN_SAMPLES = 8
FIXED_SPREAD = 0.02
"""Share of the widest motion within which a particle may be fixed in place."""
MAX_FIXED_CORRELATION = 0.5
"""Correlation of neighbouring samples from which a particle drifts and is not fixed."""
MIN_RELATIVE_NOISE = 1e-6
"""Least noise, relative to the typical distance."""


@dataclass(frozen=True, slots=True)
class CoordinateSeries:
    """N particles at T times in D axes; NaN where one was not observed."""

    t: FloatArray
    """(T,) s, increasing."""
    x: FloatArray
    """(T, N, D)"""
    sigma: float | None = None
    """Standard deviation of every coordinate, where it is known."""

    def __post_init__(self) -> None:
        if self.x.ndim != 3 or len(self.t) != len(self.x):
            raise ValueError(f"coordinates are (T, N, D) at t (T,); got {self.x.shape} at {self.t.shape}")
        if len(self.t) < MIN_SAMPLES:
            raise ValueError(f"{len(self.t)} samples; a motion needs at least {MIN_SAMPLES}")
        if np.any(np.diff(self.t) <= 0):
            raise ValueError("times must grow")
        if np.any(np.isfinite(self.x).all(axis=2).sum(axis=0) < MIN_SAMPLES):
            raise ValueError(f"every particle must be seen at least {MIN_SAMPLES} times")

    def first_samples(self, count: int) -> CoordinateSeries:
        """Return the first `count` samples."""
        return CoordinateSeries(self.t[:count], self.x[:count], self.sigma)


def fit_splines(series: CoordinateSeries) -> tuple[FloatArray, FloatArray]:
    """Compute positions and velocities (T, N, D) of cubic splines through the observations: initial guesses."""
    x, v = np.empty_like(series.x), np.empty_like(series.x)
    for i, axis in np.ndindex(series.x.shape[1:]):
        there = np.isfinite(series.x[:, i, axis])
        curve = CubicSpline(series.t[there], series.x[there, i, axis])
        inside = np.clip(series.t, series.t[there][0], series.t[there][-1])
        x[:, i, axis], v[:, i, axis] = curve(inside), curve(inside, 1)
    return x, v


def find_fixed_particles(series: CoordinateSeries) -> BoolArray:
    """Find the particles (N,) that stay in place, so that only measurement noise moves them."""
    middle = np.nanmean(series.x, axis=0)
    off = np.nan_to_num(series.x - middle)
    spread = np.sqrt((off**2).mean(axis=(0, 2)))
    wander = (off[1:] * off[:-1]).sum(axis=(0, 2)) / np.maximum((off**2).sum(axis=(0, 2)), 1e-300)
    return np.asarray((spread < FIXED_SPREAD * spread.max()) & (wander < MAX_FIXED_CORRELATION), np.bool_)


def estimate_coordinate_noise(series: CoordinateSeries, is_fixed: BoolArray) -> float | None:
    """Determine the standard deviation of a coordinate.

    It is the known one, else that of fixed particles, else None.
    """
    least = MIN_RELATIVE_NOISE * measure_scales(series).length
    if series.sigma is not None:
        return max(series.sigma, least)
    if not np.any(is_fixed):
        return None
    off = series.x[:, is_fixed] - np.nanmean(series.x[:, is_fixed], axis=0)
    there = int(np.isfinite(off).sum())
    return max(float(np.sqrt(np.nansum(off**2) / (there - off[0].size))), least)


def measure_scales(series: CoordinateSeries) -> TypicalScales:
    """Measure typical distance, sample interval and acceleration."""
    x, _ = fit_splines(series)
    i, j = np.array(list(combinations(range(x.shape[1]), 2)) or [(0, 0)]).T
    apart = np.linalg.norm(x[:, i] - x[:, j], axis=2)
    span = float(np.median(np.diff(series.t)))
    length = float(np.median(apart)) or float(np.ptp(x, axis=0).max())
    return TypicalScales(length, span, second_difference(series) / span**2)


def second_difference(series: CoordinateSeries) -> float:
    """Compute the RMS second difference of the samples."""
    return float(np.sqrt(np.nanmean(np.diff(series.x, 2, axis=0) ** 2)))


def rank_pairs_by_variation(series: CoordinateSeries) -> tuple[list[tuple[int, int]], FloatArray, FloatArray]:
    """List all pairs, their median distances, and the relative variation of these, in increasing order of variation."""
    pairs = list(combinations(range(series.x.shape[1]), 2))
    if not pairs:
        return [], np.empty(0), np.empty(0)
    i, j = np.array(pairs).T
    apart = np.linalg.norm(series.x[:, j] - series.x[:, i], axis=2)
    vary = np.nanstd(apart, axis=0) / np.nanmean(apart, axis=0)
    order = np.argsort(vary)
    return [pairs[k] for k in order], np.nanmedian(apart, axis=0)[order], vary[order]
