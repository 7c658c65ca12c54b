"""The mass-spring-damper model as a chain of states: what it predicts from one sample to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.springs.dense_shooting import Prediction
from models.estimation.springs.parameter_layout import Layout, Units
from models.physics.springs.spring_system import Springs, flow, steps_for

FARTHEST = 10.0
"""typical distances that a particle may fly between two samples; a search that goes farther has gone astray."""

MOST_STEPS = 100
"""from one sample to the next: what is too stiff for them diverges, and the search turns back."""


@dataclass(frozen=True, slots=True)
class SpringChain:
    """A graph at K samples; S = 2 D numbers of state per free particle: places, then velocities."""

    graph: Springs
    units: Units
    layout: Layout
    spans: FloatArray
    """(L,) s between samples."""
    bond: float
    """standard deviation of the length of a rod."""
    slack: bool = False
    """springs have their rest lengths at the first sample."""

    @property
    def free(self) -> IntArray:
        """(S,) inputs of `springs.flow` that are numbers of state."""
        count, axes = len(self.graph.mass), len(self.graph.gravity)
        places = np.flatnonzero(np.repeat(~self.graph.held, axes))
        return np.concatenate([places, count * axes + places])

    def allowed(self, shared: FloatArray) -> FloatArray:
        """Coordinates (P,) within their bounds."""
        return np.clip(shared, self.layout.low, self.layout.high)

    def full(self, states: FloatArray, shared: FloatArray) -> FloatArray:
        """States (K, 2, N, D) of all particles."""
        count, axes = len(self.graph.mass), len(self.graph.gravity)
        whole = np.zeros((len(states), 2 * count * axes))
        whole[:, self.free] = states
        pinned = self.layout.inputs < count * axes
        whole[:, self.layout.inputs[pinned]] = shared[self.layout.owner[pinned]]
        return whole.reshape(len(states), 2, count, axes)

    def at(self, shared: FloatArray) -> Springs:
        """The graph with the numbers of coordinates (P,)."""
        count, edges, axes = len(self.graph.mass), len(self.graph.pairs), len(self.graph.gravity)
        numbers = self.graph.numbers
        ours = self.layout.inputs >= 2 * count * axes
        values = self.layout.values(shared)[self.layout.owner]
        numbers[self.layout.inputs[ours] - 2 * count * axes] = values[ours]
        parts = np.split(numbers, np.cumsum([count, edges, edges, edges, axes, count]))
        mass, stiffness, damping, rest, gravity, radius, contact = parts
        stiffness = np.where(np.isinf(self.graph.stiffness), np.inf, stiffness)
        return replace(
            self.graph, mass=mass, stiffness=stiffness, damping=damping, rest=rest, gravity=gravity, radius=radius,
            contact=contact,
        )  # fmt: skip

    def coordinates(self, places: FloatArray) -> FloatArray:
        """Shared coordinates (P,) of the graph itself, held particles at `places` (N, D)."""
        inputs = np.concatenate([places.ravel(), np.zeros(places.size), self.graph.numbers])
        values = np.zeros(len(self.layout.names))
        values[self.layout.owner] = inputs[self.layout.inputs]
        return self.allowed(self.layout.coordinates(values))

    def predict(self, states: FloatArray, shared: FloatArray) -> Prediction:
        """Where every state is at the next sample, and how far rods are off their lengths."""
        whole, free = self.full(states, shared), self.free
        speed = 2 * float(np.abs(states[:, len(free) // 2 :]).max(initial=0.0))
        speed = min(speed, FARTHEST * self.units.length / self.units.span)
        graph, inputs = self.at(shared), np.concatenate([free, self.layout.inputs])
        steps = np.minimum(steps_for(graph, self.spans, speed), MOST_STEPS)
        moved = flow(graph, whole[:-1], self.spans, inputs, steps)
        size = len(free)
        by_input = moved.slopes[:, free, size:] * self.layout.slope(shared)[self.layout.owner]
        bonds, bonds_by_all = self._bonds(whole)
        lengths = self._lengths(whole)
        return Prediction(
            moved.ends.reshape(len(whole) - 1, -1)[:, free],
            moved.slopes[:, free, :size],
            by_input @ self._gather(),
            bonds - lengths @ shared,
            bonds_by_all[:, :, free],
            bonds_by_all[:, :, self._pins()] @ self._pinned() - lengths,
        )

    def _gather(self) -> FloatArray:
        """(I, P) adds up the inputs of each coordinate."""
        return np.eye(len(self.layout.names))[self.layout.owner]

    def _pins(self) -> IntArray:
        return self.layout.inputs[self.layout.inputs < self.graph.mass.size * self.graph.gravity.size]

    def _pinned(self) -> FloatArray:
        return self._gather()[self.layout.inputs < self.graph.mass.size * self.graph.gravity.size]

    def _slack_springs(self) -> IntArray:
        return np.flatnonzero(np.isfinite(self.graph.stiffness)) if self.slack else np.empty(0, np.int64)

    def _lengths(self, whole: FloatArray) -> FloatArray:
        """(K, 2 R + E', P) which coordinate is the length of each rod, and of each slack spring at the first sample, in
        units of `bond`."""
        rods, slack = self.graph.rods, self._slack_springs()
        count, edges = len(self.graph.mass), len(self.graph.pairs)
        first = 2 * count * len(self.graph.gravity) + count + 2 * edges
        found = np.zeros((len(whole), 2 * len(rods) + len(slack), len(self.layout.names)))
        for row, rod in enumerate(rods):
            found[:, row, self.layout.owner[self.layout.inputs == first + rod]] = 1 / self.bond
        for row, spring in enumerate(slack, 2 * len(rods)):
            found[0, row, self.layout.owner[self.layout.inputs == first + spring]] = 1 / self.bond
        return found

    def _bonds(self, whole: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lengths of rods and their rates over a sample, then lengths of slack springs, over `bond` (K, 2 R + E'), and
        slopes (K, 2 R + E', 2 N D) by states."""
        rods, slack, count = self.graph.rods, self._slack_springs(), len(whole)
        length, speed, slopes = _stretch(whole, self.graph.pairs[rods], self.units.span)
        late = np.arange(count)[:, None] > 0
        resting, _, by_rest = _stretch(whole, self.graph.pairs[slack], self.units.span)
        values = np.concatenate([length, speed, np.where(late, 0.0, resting)], axis=1)
        by_states = np.concatenate([
            slopes.reshape(count, 2 * len(rods), whole[0].size), np.where(late[..., None], 0.0, by_rest[:, 0])
        ], axis=1)  # fmt: skip
        return values / self.bond, by_states / self.bond


def _stretch(whole: FloatArray, pairs: IntArray, span: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distances of pairs (R, 2) in states (K, 2, N, D) and their changes in `span` (K, R); slopes (K, 2, R, 2 N D)."""
    i, j = pairs.T
    apart, rate = whole[:, 0, j] - whole[:, 0, i], whole[:, 1, j] - whole[:, 1, i]  # (K, R, D)
    length = np.linalg.norm(apart, axis=2)
    along = apart / length[:, :, None]
    speed = (along * rate).sum(axis=2)
    bent = (rate - speed[:, :, None] * along) / length[:, :, None]
    slopes = np.zeros((len(whole), 2, len(i), *whole.shape[1:]))
    for r in range(len(i)):
        for end, sign in ((j[r], 1.0), (i[r], -1.0)):
            slopes[:, 0, r, 0, end] = sign * along[:, r]
            slopes[:, 1, r, 0, end] = sign * bent[:, r] * span
            slopes[:, 1, r, 1, end] = sign * along[:, r] * span
    return length, speed * span, slopes.reshape(len(whole), 2, len(i), whole[0].size)
