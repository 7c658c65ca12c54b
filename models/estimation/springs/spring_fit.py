"""Fit of one graph of springs to coordinates, as a chain of states that predicts from one sample to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray
from models.estimation.springs.dense_shooting import (
    ChainEstimate,
    ChainObservations,
    ChainPrediction,
    build_normal_equations,
    information_of_shared,
    minimize_chain,
    start_chain,
)
from models.estimation.springs.parameter_layout import (
    SpringLayout,
    TypicalScales,
    build_layout,
    fit_splines,
    measure_scales,
    second_difference,
)
from models.numerics.least_squares import invert_semidefinite
from models.physics.springs.spring_system import SpringSystem, count_steps, integrate_springs

# Sigma of the first links, relative to the second difference of the coordinates.
FIRST_LINK_SIGMA = 0.3
# Sigma of the last links, relative to the noise; its effect on the error of a state is negligible.
LAST_LINK_SIGMA = 0.002
# Tolerance of a start from rest, relative to the scale of a state.
REST_SIGMA = 1e-6
# Guessed noise, relative to the second difference of the coordinates.
GUESSED_NOISE = 0.01


@dataclass(frozen=True, slots=True)
class SearchEffort:
    """Iteration limits of a search."""

    stages: int = 4
    """From loose to tight links."""
    iterations: int = 8
    """Per stage."""
    last_iterations: int = 20
    """Of the last stage."""
    last_link_sigma: float = LAST_LINK_SIGMA
    """Relative to the noise."""


THOROUGH = SearchEffort()
QUICK = SearchEffort(stages=3, iterations=5, last_iterations=5, last_link_sigma=0.5)


@dataclass(frozen=True, slots=True)
class SpringFit:
    """A graph whose parameters were fitted to coordinates."""

    model: _SpringChain
    observed: ChainObservations
    chain: ChainEstimate
    noise: float
    """Assumed standard deviation of a coordinate."""

    @property
    def graph(self) -> SpringSystem:
        """The graph with its fitted parameters."""
        return self.model.graph_at(self.chain.shared)

    @property
    def states(self) -> FloatArray:
        """(T, 2, N, D) positions and velocities at the samples."""
        return self.model.full_states(self.chain.states, self.chain.shared)

    @property
    def values(self) -> dict[str, float]:
        """Fitted parameters by name."""
        values = self.model.layout.values(self.chain.shared)
        return dict(zip(self.model.layout.names, values.tolist(), strict=True))

    @property
    def freedom(self) -> int:
        """Degrees of freedom: observed rows less one start, constraints and shared parameters."""
        start = int(self.chain.states.shape[1] - self.chain.prediction.constraints.shape[1])
        rows = int((self.observed.weight > 0).sum() + (self.observed.shared_weight > 0).sum())
        return rows - start - len(self.chain.shared)


def fit_graph(
    series: Recording, graph: SpringSystem, noise: float | None, effort: SearchEffort = THOROUGH,
    layout: SpringLayout | None = None, start: SpringFit | None = None,
) -> SpringFit:  # fmt: skip
    """Fit the parameters of a graph.

    Args:
        series: Observed coordinates.
        graph: Graph whose parameters are the initial guess.
        noise: Standard deviation of a coordinate; guessed where not given.
        effort: Iteration limits.
        layout: Coordinates of the search; all identifiable ones where not given.
        start: Earlier fit to start from, possibly of fewer samples.

    Returns:
        The fit.
    """
    size = measure_scales(series)
    coordinates = build_layout(graph, size) if layout is None else layout
    error = GUESSED_NOISE * second_difference(series) if noise is None else noise
    model = _SpringChain(graph, size, coordinates, np.diff(series.t), 1.0)
    x, v = fit_splines(series)
    shared = model.coordinates(np.where(graph.fixed[:, None], np.nanmean(series.positions, axis=0), 0.0))
    states = np.stack([x, v], axis=1).reshape(len(x), -1)[:, model.state_inputs]
    if start is not None and np.array_equal(start.graph.fixed, graph.fixed):
        states[: len(start.chain.states)] = start.chain.states
    observed = _build_observations(series, model, shared, error)
    chain = start_chain(model, observed, states, shared, np.ones(model.state_inputs.size))
    return tighten_links(SpringFit(model, observed, chain, error), FIRST_LINK_SIGMA * second_difference(series), effort)


def _build_observations(series: Recording, model: _SpringChain, shared: FloatArray, noise: float) -> ChainObservations:
    """Build the observations of the chain; those of fixed particles become priors of their positions."""
    half = model.state_inputs.size // 2
    there = np.isfinite(series.positions).reshape(len(series.positions), -1)[:, model.state_inputs[:half]]
    states = np.zeros((len(series.positions), 2 * half))
    states[:, :half] = np.nan_to_num(series.positions).reshape(len(series.positions), -1)[:, model.state_inputs[:half]]
    weight = np.concatenate([there / noise, np.zeros_like(states[:, half:])], axis=1)
    pins = np.zeros(len(shared))
    count = np.isfinite(series.positions).sum(axis=0).ravel()
    sets = model.layout.inputs < count.size
    pins[model.layout.owner[sets]] = np.sqrt(count[model.layout.inputs[sets]]) / noise
    scale = np.repeat([1.0, 1 / model.units.span], half)
    return ChainObservations(states, weight, shared.copy(), pins, model.layout.scale, scale)


def tighten_links(fit: SpringFit, first_link_sigma: float, effort: SearchEffort = THOROUGH) -> SpringFit:
    """Refit while the links are tightened in stages, starting at `first_link_sigma`."""
    half = fit.model.state_inputs.size // 2
    tightest = effort.last_link_sigma * fit.noise
    for tie in np.geomspace(max(first_link_sigma, tightest), tightest, effort.stages):
        model = replace(fit.model, constraint_sigma=float(tie))
        ties = np.repeat([tie, tie / fit.model.units.span], half)
        chain = start_chain(model, fit.observed, fit.chain.states, fit.chain.shared, ties)
        chain = minimize_chain(
            model, fit.observed, chain, effort.last_iterations if tie == tightest else effort.iterations
        )
        fit = replace(fit, model=model, chain=chain)
    return fit


def assume_unstretched_start(fit: SpringFit) -> SpringFit:
    """Assume that no spring is stretched at the first sample; the result is not fitted yet."""
    return replace(fit, model=replace(fit.model, starts_unstretched=True))


def assume_resting_start(fit: SpringFit) -> SpringFit:
    """Assume that nothing moves at the first sample; the result is not fitted yet."""
    half = fit.model.state_inputs.size // 2
    states, weight = fit.observed.states.copy(), fit.observed.weight.copy()
    states[0, half:] = 0.0
    weight[0, half:] = fit.model.units.span / (REST_SIGMA * fit.model.units.length)
    return replace(fit, observed=replace(fit.observed, states=states, weight=weight))


def position_residuals(fit: SpringFit) -> FloatArray:
    """Compute fitted minus observed positions (T, S / 2) of free particles; NaN where they were not observed."""
    half = fit.chain.states.shape[1] // 2
    off = fit.chain.states[:, :half] - fit.observed.states[:, :half]
    return np.where(fit.observed.weight[:, :half] > 0, off, np.nan)


def covariance_of_shared(fit: SpringFit) -> FloatArray:
    """Compute the covariance (P, P) of the shared coordinates."""
    return invert_semidefinite(information_of_shared(build_normal_equations(fit.observed, fit.chain)))


# Typical distances that a particle may move between two samples; beyond that, a search has diverged.
MAX_FLIGHT = 10.0

# Steps from one sample to the next: a stiffer system diverges, and the search turns back.
MAX_STEPS = 100


@dataclass(frozen=True, slots=True)
class _SpringChain:
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
