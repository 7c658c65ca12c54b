"""Layout of the fitted parameters of a graph of springs as search coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, IntArray
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
