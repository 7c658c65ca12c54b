"""Measured coordinates of particles, and the fitted parameters of a graph of springs as search coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.physics.springs.spring_system import SpringSystem

# rad between two samples: stiffer springs are fitted as rods.
MAX_PHASE = 60.0
# rad between two samples: weaker springs have no effect.
MIN_PHASE = 1e-3
# Largest ratio of two masses.
MAX_MASS_RATIO = 1e3


@dataclass(frozen=True, slots=True)
class SpringLayout:
    """P shared coordinates, and the I inputs of the spring flow that they set, one or several each."""

    names: tuple[str, ...]
    """(P,) such as `stiffness 0-1`."""
    inputs: IntArray
    """(I,)"""
    owner: IntArray
    """(I,) coordinate that sets each input."""
    logarithmic: NDArray[np.bool_]
    """(P,) True where the coordinate is the logarithm of the parameter."""
    scale: FloatArray
    """(P,) typical step of a coordinate."""
    low: FloatArray
    """(P,)"""
    high: FloatArray
    """(P,)"""

    def values(self, shared: FloatArray) -> FloatArray:
        """Convert coordinates into parameters (P,)."""
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, shared, 0.0)), shared)

    def slope(self, shared: FloatArray) -> FloatArray:
        """Compute d parameter / d coordinate (P,)."""
        return np.where(self.logarithmic, self.values(shared), 1.0)

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Convert parameters into coordinates (P,)."""
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)

    def drop_coordinates(self, names: set[str]) -> SpringLayout:
        """Return the layout without some coordinates."""
        is_kept = np.array([name not in names for name in self.names], bool)
        return self._relabel_coordinates(np.where(is_kept, np.cumsum(is_kept) - 1, -1))

    def merge_coordinates(self, names: list[str], name: str) -> SpringLayout:
        """Return the layout in which the first of these coordinates, named `name`, sets all of their inputs."""
        first = self.names.index(names[0])
        others = np.array([one in names[1:] for one in self.names], bool)
        target = np.cumsum(~others) - 1
        merged = self._relabel_coordinates(np.where(others, target[first], target))
        return replace(merged, names=tuple(name if one == names[0] else one for one in merged.names))

    def _relabel_coordinates(self, target: IntArray) -> SpringLayout:
        """Replace coordinate k by coordinate target[k] (P,), or drop it where that is -1."""
        first_owners = [int(np.flatnonzero(target == new)[0]) for new in range(int(target.max(initial=-1)) + 1)]
        owner = target[self.owner]
        return SpringLayout(
            tuple(self.names[k] for k in first_owners), self.inputs[owner >= 0], owner[owner >= 0],
            self.logarithmic[first_owners], self.scale[first_owners], self.low[first_owners], self.high[first_owners],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class TypicalScales:
    """Typical scales of a recording."""

    length: float
    """Typical distance of particles."""
    span: float
    """s from sample to sample."""
    acceleration: float
    """length/s^2"""


@dataclass(frozen=True, slots=True)
class _CoordinateSpec:
    """Specification of one coordinate."""

    name: str
    inputs: list[int]
    logarithmic: bool
    scale: float
    low: float
    high: float


def build_layout(graph: SpringSystem, units: TypicalScales) -> SpringLayout:
    """List the identifiable parameters of a graph; the common scale of the masses of a connected group is not one."""
    rows = _list_coordinates(graph, units)
    return SpringLayout(
        tuple(row.name for row in rows),
        np.array([k for row in rows for k in row.inputs], np.int64),
        np.repeat(np.arange(len(rows)), [len(row.inputs) for row in rows]),
        np.array([row.logarithmic for row in rows], bool),
        np.array([row.scale for row in rows], np.float64),
        np.array([row.low for row in rows], np.float64),
        np.array([row.high for row in rows], np.float64),
    )


def _list_coordinates(graph: SpringSystem, units: TypicalScales) -> list[_CoordinateSpec]:
    count, axes, edges = len(graph.mass), len(graph.gravity), len(graph.pairs)
    mass, stiffness, damping, rest, gravity, radius, contact = (
        2 * count * axes + np.cumsum([0, count, edges, edges, edges, axes, count])
    ).tolist()
    labels = [f"{i}-{j}" for i, j in graph.pairs]
    slowest, fastest = (2 * float(np.log(phase / units.span)) for phase in (MIN_PHASE, MAX_PHASE))
    widest, decay = float(np.log(MAX_MASS_RATIO)), 1 / units.span
    springy, fixed = np.flatnonzero(np.isfinite(graph.stiffness)).tolist(), np.flatnonzero(graph.fixed).tolist()
    lighter = np.setdiff1d(np.flatnonzero(~graph.fixed), find_reference_particles(graph)).tolist()
    rows = [_CoordinateSpec(f"mass {i}", [mass + i], True, 1.0, -widest, widest) for i in lighter]
    rows += [_CoordinateSpec(f"stiffness {labels[e]}", [stiffness + e], True, 1.5, slowest, fastest) for e in springy]
    rows += [_CoordinateSpec(f"damping {labels[e]}", [damping + e], False, 5 * decay, 0.0, 20 * decay) for e in springy]
    shortest, longest = 1e-3 * units.length, 1e2 * units.length
    rows += [
        _CoordinateSpec(f"rest {labels[e]}", [rest + e], False, units.length, shortest, longest) for e in range(edges)
    ]
    for axis in range(axes):
        rows.append(
            _CoordinateSpec(f"gravity {'xyz'[axis]}", [gravity + axis], False, 10 * units.acceleration, -np.inf, np.inf)
        )
    for i in fixed:
        for axis in range(axes):
            rows.append(
                _CoordinateSpec(f"place {i} {'xyz'[axis]}", [i * axes + axis], False, units.length, -np.inf, np.inf)
            )
    if len(graph.colliding_pairs):
        surfaces = [radius + i for i in np.flatnonzero(graph.radius).tolist()]
        rows.append(_CoordinateSpec("radius", surfaces, False, units.length, 0.0, np.inf))
        rows.append(_CoordinateSpec("contact stiffness", [contact], True, 1.5, slowest, 2 * fastest))
        rows.append(_CoordinateSpec("contact damping", [contact + 1], False, 5 * decay, 0.0, 100 * decay))
    return rows


def find_reference_particles(graph: SpringSystem) -> IntArray:
    """Find the first free particle of every connected group: its mass is the unit of its group."""
    group = np.arange(len(graph.mass))
    for _ in range(len(group)):
        for i, j in np.concatenate([graph.pairs, graph.colliding_pairs]):
            if not (graph.fixed[i] or graph.fixed[j]):
                group[[i, j]] = group[[i, j]].min()
    free = np.flatnonzero(~graph.fixed)
    return free[np.unique(group[free], return_index=True)[1]]


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
