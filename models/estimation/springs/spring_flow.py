"""The mass-spring-damper model as a chain of states: its prediction from one sample to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.springs.dense_shooting import ChainPrediction
from models.estimation.springs.parameter_layout import SpringLayout, TypicalScales
from models.physics.springs.spring_system import SpringSystem, count_steps, integrate_springs

MAX_FLIGHT = 10.0
"""Typical distances that a particle may move between two samples; beyond that, a search has diverged."""

MAX_STEPS = 100
"""Steps from one sample to the next: a stiffer system diverges, and the search turns back."""


@dataclass(frozen=True, slots=True)
class SpringChain:
    """A graph at K samples; S = 2 D state variables per free particle: positions, then velocities."""

    graph: SpringSystem
    units: TypicalScales
    layout: SpringLayout
    spans: FloatArray
    """(L,) s between samples."""
    constraint_sigma: float
    """Standard deviation of the length of a rod."""
    starts_unstretched: bool = False
    """Whether springs have their rest lengths at the first sample."""

    @property
    def state_inputs(self) -> IntArray:
        """(S,) inputs of the spring flow that are state variables."""
        count, axes = len(self.graph.mass), len(self.graph.gravity)
        places = np.flatnonzero(np.repeat(~self.graph.fixed, axes))
        return np.concatenate([places, count * axes + places])

    def clip_shared(self, shared: FloatArray) -> FloatArray:
        """Clip coordinates (P,) to their bounds."""
        return np.clip(shared, self.layout.low, self.layout.high)

    def full_states(self, states: FloatArray, shared: FloatArray) -> FloatArray:
        """Insert the fixed particles: states (K, 2, N, D) of all particles."""
        count, axes = len(self.graph.mass), len(self.graph.gravity)
        whole = np.zeros((len(states), 2 * count * axes))
        whole[:, self.state_inputs] = states
        pinned = self.layout.inputs < count * axes
        whole[:, self.layout.inputs[pinned]] = shared[self.layout.owner[pinned]]
        return whole.reshape(len(states), 2, count, axes)

    def graph_at(self, shared: FloatArray) -> SpringSystem:
        """Build the graph with the parameters of coordinates (P,)."""
        count, edges, axes = len(self.graph.mass), len(self.graph.pairs), len(self.graph.gravity)
        numbers = self.graph.parameters
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
        """Compute the shared coordinates (P,) of the graph itself, with fixed particles at `places` (N, D)."""
        inputs = np.concatenate([places.ravel(), np.zeros(places.size), self.graph.parameters])
        values = np.zeros(len(self.layout.names))
        values[self.layout.owner] = inputs[self.layout.inputs]
        return self.clip_shared(self.layout.coordinates(values))

    def predict(self, states: FloatArray, shared: FloatArray) -> ChainPrediction:
        """Predict every state at the next sample, and the length errors of rods."""
        whole, free = self.full_states(states, shared), self.state_inputs
        speed = 2 * float(np.abs(states[:, len(free) // 2 :]).max(initial=0.0))
        speed = min(speed, MAX_FLIGHT * self.units.length / self.units.span)
        graph, inputs = self.graph_at(shared), np.concatenate([free, self.layout.inputs])
        steps = np.minimum(count_steps(graph, self.spans, speed), MAX_STEPS)
        moved = integrate_springs(graph, whole[:-1], self.spans, inputs, steps)
        size = len(free)
        by_input = moved.slopes[:, free, size:] * self.layout.slope(shared)[self.layout.owner]
        bonds, bonds_by_all = self._constraint_values(whole)
        lengths = self._constraint_lengths(whole)
        is_fixed = self.layout.inputs < self.graph.mass.size * self.graph.gravity.size  # positions of fixed particles
        return ChainPrediction(
            moved.ends.reshape(len(whole) - 1, -1)[:, free],
            moved.slopes[:, free, :size],
            by_input @ self._gather_matrix(),
            bonds - lengths @ shared,
            bonds_by_all[:, :, free],
            bonds_by_all[:, :, self.layout.inputs[is_fixed]] @ self._gather_matrix()[is_fixed] - lengths,
        )

    def _gather_matrix(self) -> FloatArray:
        """Return the matrix (I, P) that sums the inputs of each coordinate."""
        return np.eye(len(self.layout.names))[self.layout.owner]

    def _slack_springs(self) -> IntArray:
        """Return the springs that are unstretched at the first sample."""
        return np.flatnonzero(np.isfinite(self.graph.stiffness)) if self.starts_unstretched else np.empty(0, np.int64)

    def _constraint_lengths(self, whole: FloatArray) -> FloatArray:
        """Return the derivative (K, 2 R + E', P) of required lengths by the coordinates, over `constraint_sigma`.

        The rows are the lengths of rods, their rates, and the lengths of unstretched springs at the first sample.
        """
        rods, slack = self.graph.rods, self._slack_springs()
        count, edges = len(self.graph.mass), len(self.graph.pairs)
        first = 2 * count * len(self.graph.gravity) + count + 2 * edges
        lengths = np.zeros((len(whole), 2 * len(rods) + len(slack), len(self.layout.names)))
        for row, rod in enumerate(rods):
            lengths[:, row, self.layout.owner[self.layout.inputs == first + rod]] = 1 / self.constraint_sigma
        for row, spring in enumerate(slack, 2 * len(rods)):
            lengths[0, row, self.layout.owner[self.layout.inputs == first + spring]] = 1 / self.constraint_sigma
        return lengths

    def _constraint_values(self, whole: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute lengths of rods, their change in a sample, and lengths of unstretched springs.

        Return values (K, 2 R + E') over `constraint_sigma`, and their derivatives (K, 2 R + E', 2 N D) by the states.
        """
        rods, slack, count = self.graph.rods, self._slack_springs(), len(whole)
        length, speed, slopes = _pair_distances(whole, self.graph.pairs[rods], self.units.span)
        late = np.arange(count)[:, None] > 0
        resting, _, by_rest = _pair_distances(whole, self.graph.pairs[slack], self.units.span)
        values = np.concatenate([length, speed, np.where(late, 0.0, resting)], axis=1)
        by_states = np.concatenate([
            slopes.reshape(count, 2 * len(rods), whole[0].size), np.where(late[..., None], 0.0, by_rest[:, 0])
        ], axis=1)  # fmt: skip
        return values / self.constraint_sigma, by_states / self.constraint_sigma


def _pair_distances(whole: FloatArray, pairs: IntArray, span: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute distances of pairs (R, 2) in states (K, 2, N, D), their changes in `span` (K, R), and derivatives.

    The derivatives (K, 2, R, 2 N D) are by the states.
    """
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
