"""Which numbers of a graph of springs are sought, as coordinates of a search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, IntArray
from models.physics.springs.spring_system import Springs

FASTEST_SWING = 60.0
"""rad between two samples: stiffer springs are sought as rods."""
LEAST_SWING = 1e-3
"""rad between two samples: weaker springs are as good as none."""
WIDEST_RATIO = 1e3
"""of two masses."""


@dataclass(frozen=True, slots=True)
class Layout:
    """P shared coordinates and the I inputs of `springs.flow` that they set, one or several each."""

    names: tuple[str, ...]
    """(P,) such as `stiffness 0-1`."""
    inputs: IntArray
    """(I,)"""
    owner: IntArray
    """(I,) coordinate that sets it."""
    logarithmic: NDArray[np.bool_]
    """(P,) True where the coordinate is the logarithm of the number."""
    scale: FloatArray
    """(P,) by how much a coordinate may move at a time."""
    low: FloatArray
    """(P,)"""
    high: FloatArray
    """(P,)"""

    def values(self, shared: FloatArray) -> FloatArray:
        """(P,) numbers of coordinates."""
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, shared, 0.0)), shared)

    def slope(self, shared: FloatArray) -> FloatArray:
        """(P,) d number / d coordinate."""
        return np.where(self.logarithmic, self.values(shared), 1.0)

    def coordinates(self, values: FloatArray) -> FloatArray:
        """(P,) of numbers."""
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)

    def without(self, names: set[str]) -> Layout:
        """The layout in which these coordinates are not sought."""
        kept = np.array([name not in names for name in self.names], bool)
        return self._merged(np.where(kept, np.cumsum(kept) - 1, -1))

    def alike(self, names: list[str], name: str) -> Layout:
        """The layout in which the first of these coordinates, called `name`, sets all that they set."""
        first = self.names.index(names[0])
        others = np.array([one in names[1:] for one in self.names], bool)
        target = np.cumsum(~others) - 1
        merged = self._merged(np.where(others, target[first], target))
        return replace(merged, names=tuple(name if one == names[0] else one for one in merged.names))

    def _merged(self, target: IntArray) -> Layout:
        """Old coordinate k becomes new coordinate target[k] (P,), or is dropped where that is -1."""
        kept = [int(np.flatnonzero(target == new)[0]) for new in range(int(target.max(initial=-1)) + 1)]
        owner = target[self.owner]
        return Layout(
            tuple(self.names[k] for k in kept), self.inputs[owner >= 0], owner[owner >= 0], self.logarithmic[kept],
            self.scale[kept], self.low[kept], self.high[kept],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Units:
    """What is large in a recording."""

    length: float
    """typical distance of particles."""
    span: float
    """s from sample to sample."""
    pull: float
    """length/s^2: typical acceleration."""


@dataclass(frozen=True, slots=True)
class _Row:
    """One coordinate in the making."""

    name: str
    inputs: list[int]
    logarithmic: bool
    scale: float
    low: float
    high: float


def layout(graph: Springs, units: Units) -> Layout:
    """What can be told of a graph from coordinates: the scale of all masses of particles that hang together cannot."""
    rows = _rows(graph, units)
    return Layout(
        tuple(row.name for row in rows),
        np.array([k for row in rows for k in row.inputs], np.int64),
        np.repeat(np.arange(len(rows)), [len(row.inputs) for row in rows]),
        np.array([row.logarithmic for row in rows], bool),
        np.array([row.scale for row in rows], np.float64),
        np.array([row.low for row in rows], np.float64),
        np.array([row.high for row in rows], np.float64),
    )


def _rows(graph: Springs, units: Units) -> list[_Row]:
    count, axes, edges = len(graph.mass), len(graph.gravity), len(graph.pairs)
    mass, stiffness, damping, rest, gravity, radius, contact = (
        2 * count * axes + np.cumsum([0, count, edges, edges, edges, axes, count])
    ).tolist()
    labels = [f"{i}-{j}" for i, j in graph.pairs]
    slowest, fastest = (2 * float(np.log(swing / units.span)) for swing in (LEAST_SWING, FASTEST_SWING))
    widest, decay = float(np.log(WIDEST_RATIO)), 1 / units.span
    springy, held = np.flatnonzero(np.isfinite(graph.stiffness)).tolist(), np.flatnonzero(graph.held).tolist()
    lighter = np.setdiff1d(np.flatnonzero(~graph.held), standards(graph)).tolist()
    rows = [_Row(f"mass {i}", [mass + i], True, 1.0, -widest, widest) for i in lighter]
    rows += [_Row(f"stiffness {labels[e]}", [stiffness + e], True, 1.5, slowest, fastest) for e in springy]
    rows += [_Row(f"damping {labels[e]}", [damping + e], False, 5 * decay, 0.0, 20 * decay) for e in springy]
    shortest, longest = 1e-3 * units.length, 1e2 * units.length
    rows += [_Row(f"rest {labels[e]}", [rest + e], False, units.length, shortest, longest) for e in range(edges)]
    for axis in range(axes):
        rows.append(_Row(f"gravity {'xyz'[axis]}", [gravity + axis], False, 10 * units.pull, -np.inf, np.inf))
    for i in held:
        for axis in range(axes):
            rows.append(_Row(f"place {i} {'xyz'[axis]}", [i * axes + axis], False, units.length, -np.inf, np.inf))
    if len(graph.touching):
        surfaces = [radius + i for i in np.flatnonzero(graph.radius).tolist()]
        rows.append(_Row("radius", surfaces, False, units.length, 0.0, np.inf))
        rows.append(_Row("contact stiffness", [contact], True, 1.5, slowest, 2 * fastest))
        rows.append(_Row("contact damping", [contact + 1], False, 5 * decay, 0.0, 100 * decay))
    return rows


def standards(graph: Springs) -> IntArray:
    """The first free particle of every group that hangs together: its mass is the unit of its group."""
    group = np.arange(len(graph.mass))
    for _ in range(len(group)):
        for i, j in np.concatenate([graph.pairs, graph.touching]):
            if not (graph.held[i] or graph.held[j]):
                group[[i, j]] = group[[i, j]].min()
    free = np.flatnonzero(~graph.held)
    return free[np.unique(group[free], return_index=True)[1]]
