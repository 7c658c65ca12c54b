"""Measured coordinates of particles, and their statistics before any model is fitted."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.springs.parameter_layout import TypicalScales

MIN_SAMPLES = 8
# Share of the widest motion within which a particle may be fixed in place.
FIXED_SPREAD = 0.02
# Correlation of neighbouring samples from which a particle drifts and is not fixed.
MAX_FIXED_CORRELATION = 0.5
# Least noise, relative to the typical distance.
MIN_RELATIVE_NOISE = 1e-6


def fit_splines(series: Recording) -> tuple[FloatArray, FloatArray]:
    """Compute positions and velocities (T, N, D) of cubic splines through the observations: initial guesses."""
    x, v = np.empty_like(series.positions), np.empty_like(series.positions)
    for i, axis in np.ndindex(series.positions.shape[1:]):
        there = np.isfinite(series.positions[:, i, axis])
        curve = CubicSpline(series.t[there], series.positions[there, i, axis])
        inside = np.clip(series.t, series.t[there][0], series.t[there][-1])
        x[:, i, axis], v[:, i, axis] = curve(inside), curve(inside, 1)
    return x, v


def find_fixed_particles(series: Recording) -> BoolArray:
    """Find the particles (N,) that stay in place, so that only measurement noise moves them."""
    middle = np.nanmean(series.positions, axis=0)
    off = np.nan_to_num(series.positions - middle)
    spread = np.sqrt((off**2).mean(axis=(0, 2)))
    wander = (off[1:] * off[:-1]).sum(axis=(0, 2)) / np.maximum((off**2).sum(axis=(0, 2)), 1e-300)
    return np.asarray((spread < FIXED_SPREAD * spread.max()) & (wander < MAX_FIXED_CORRELATION), np.bool_)


def estimate_coordinate_noise(series: Recording, is_fixed: BoolArray) -> float | None:
    """Determine the standard deviation of a coordinate.

    It is the known one, else that of fixed particles, else None.
    """
    least = MIN_RELATIVE_NOISE * measure_scales(series).length
    if np.any(np.isfinite(series.sigma)):
        return max(float(np.sqrt(np.nanmean(series.sigma**2))), least)
    if not np.any(is_fixed):
        return None
    off = series.positions[:, is_fixed] - np.nanmean(series.positions[:, is_fixed], axis=0)
    there = int(np.isfinite(off).sum())
    return max(float(np.sqrt(np.nansum(off**2) / (there - off[0].size))), least)


def measure_scales(series: Recording) -> TypicalScales:
    """Measure typical distance, sample interval and acceleration."""
    x, _ = fit_splines(series)
    i, j = np.array(list(combinations(range(x.shape[1]), 2)) or [(0, 0)]).T
    apart = np.linalg.norm(x[:, i] - x[:, j], axis=2)
    span = float(np.median(np.diff(series.t)))
    length = float(np.median(apart)) or float(np.ptp(x, axis=0).max())
    return TypicalScales(length, span, second_difference(series) / span**2)


def second_difference(series: Recording) -> float:
    """Compute the RMS second difference of the samples."""
    return float(np.sqrt(np.nanmean(np.diff(series.positions, 2, axis=0) ** 2)))


def rank_pairs_by_variation(series: Recording) -> tuple[list[tuple[int, int]], FloatArray, FloatArray]:
    """List all pairs, their median distances, and the relative variation of these, in increasing order of variation."""
    pairs = list(combinations(range(series.positions.shape[1]), 2))
    if not pairs:
        return [], np.empty(0), np.empty(0)
    i, j = np.array(pairs).T
    apart = np.linalg.norm(series.positions[:, j] - series.positions[:, i], axis=2)
    vary = np.nanstd(apart, axis=0) / np.nanmean(apart, axis=0)
    order = np.argsort(vary)
    return [pairs[k] for k in order], np.nanmedian(apart, axis=0)[order], vary[order]
