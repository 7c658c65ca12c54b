"""Fit of one graph of springs to coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import fit_splines, measure_scales, second_difference
from models.estimation.springs.dense_shooting import (
    ChainEstimate,
    ChainObservations,
    build_normal_equations,
    information_of_shared,
    minimize_chain,
    start_chain,
)
from models.estimation.springs.parameter_layout import SpringLayout, build_layout
from models.estimation.springs.spring_flow import SpringChain
from models.numerics.least_squares import invert_semidefinite
from models.physics.springs.spring_system import SpringSystem

FIRST_LINK_SIGMA = 0.3
"""Sigma of the first links, relative to the second difference of the coordinates."""
LAST_LINK_SIGMA = 0.002
"""Sigma of the last links, relative to the noise; its effect on the error of a state is negligible."""
REST_SIGMA = 1e-6
"""Tolerance of a start from rest, relative to the scale of a state."""
GUESSED_NOISE = 0.01
"""Guessed noise, relative to the second difference of the coordinates."""


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

    model: SpringChain
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
    model = SpringChain(graph, size, coordinates, np.diff(series.t), 1.0)
    x, v = fit_splines(series)
    shared = model.coordinates(np.where(graph.fixed[:, None], np.nanmean(series.positions, axis=0), 0.0))
    states = np.stack([x, v], axis=1).reshape(len(x), -1)[:, model.state_inputs]
    if start is not None and np.array_equal(start.graph.fixed, graph.fixed):
        states[: len(start.chain.states)] = start.chain.states
    observed = _build_observations(series, model, shared, error)
    chain = start_chain(model, observed, states, shared, np.ones(model.state_inputs.size))
    return tighten_links(SpringFit(model, observed, chain, error), FIRST_LINK_SIGMA * second_difference(series), effort)


def _build_observations(series: Recording, model: SpringChain, shared: FloatArray, noise: float) -> ChainObservations:
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
