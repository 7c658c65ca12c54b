"""The fit of one graph of springs to coordinates, and the search for how stiff its springs are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.springs.coordinate_series import Coordinates, bend, filled, units
from models.estimation.springs.dense_shooting import Chain, Seen, begin, information, normal_equations, relaxed
from models.estimation.springs.parameter_layout import Layout, layout
from models.estimation.springs.spring_flow import SpringChain
from models.physics.springs.spring_system import Springs

LOOSE = 0.3
"""of the bend of the paths: how loosely links are tied first."""
TIGHT = 0.002
"""of the noise: how tightly links are tied last; what that adds to the error of a state is not seen."""
REST = 1e-6
"""of a state's scale: how exactly a particle that starts from rest does."""
GUESSED_NOISE = 0.01
"""of the bend of the paths, where nothing tells the noise."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How long to search."""

    stages: int = 4
    """from loose to tight ties."""
    iterations: int = 8
    """per stage."""
    last: int = 20
    """iterations of the last stage."""
    tightest: float = TIGHT
    """of the noise."""


THOROUGH = Effort()
GLANCE = Effort(stages=3, iterations=5, last=5, tightest=0.5)


@dataclass(frozen=True, slots=True)
class SpringFit:
    """A graph whose numbers fit coordinates."""

    model: SpringChain
    seen: Seen
    chain: Chain
    noise: float
    """standard deviation of a coordinate that was assumed."""

    @property
    def graph(self) -> Springs:
        return self.model.at(self.chain.shared)

    @property
    def states(self) -> FloatArray:
        """(T, 2, N, D)"""
        return self.model.full(self.chain.states, self.chain.shared)

    @property
    def values(self) -> dict[str, float]:
        """Numbers by their names."""
        found = self.model.layout.values(self.chain.shared)
        return dict(zip(self.model.layout.names, found.tolist(), strict=True))

    @property
    def freedom(self) -> int:
        """Rows that were observed less numbers that were fitted: one start, bonds kept, and what is shared."""
        start = int(self.chain.states.shape[1] - self.chain.prediction.bonds.shape[1])
        rows = int((self.seen.weight > 0).sum() + (self.seen.shared_weight > 0).sum())
        return rows - start - len(self.chain.shared)


def fit_graph(
    seen: Coordinates, graph: Springs, noise: float | None, effort: Effort = THOROUGH, sought: Layout | None = None,
    start: SpringFit | None = None,
) -> SpringFit:  # fmt: skip
    """Fit the numbers of a graph, from those it has, or from an earlier fit `start` of perhaps fewer samples.

    `sought` are the coordinates of the search; all that can be told where not given.
    """
    size = units(seen)
    coordinates = layout(graph, size) if sought is None else sought
    error = GUESSED_NOISE * bend(seen) if noise is None else noise
    model = SpringChain(graph, size, coordinates, np.diff(seen.t), 1.0)
    x, v = filled(seen)
    shared = model.coordinates(np.where(graph.held[:, None], np.nanmean(seen.x, axis=0), 0.0))
    states = np.stack([x, v], axis=1).reshape(len(x), -1)[:, model.free]
    if start is not None and np.array_equal(start.graph.held, graph.held):
        states[: len(start.chain.states)] = start.chain.states
    observed = _observed(seen, model, shared, error)
    chain = begin(model, observed, states, shared, np.ones(model.free.size))
    return descended(SpringFit(model, observed, chain, error), LOOSE * bend(seen), effort)


def _observed(seen: Coordinates, model: SpringChain, shared: FloatArray, noise: float) -> Seen:
    half = model.free.size // 2
    there = np.isfinite(seen.x).reshape(len(seen.x), -1)[:, model.free[:half]]
    states = np.zeros((len(seen.x), 2 * half))
    states[:, :half] = np.nan_to_num(seen.x).reshape(len(seen.x), -1)[:, model.free[:half]]
    weight = np.concatenate([there / noise, np.zeros_like(states[:, half:])], axis=1)
    pins = np.zeros(len(shared))
    count = np.isfinite(seen.x).sum(axis=0).ravel()
    sets = model.layout.inputs < count.size
    pins[model.layout.owner[sets]] = np.sqrt(count[model.layout.inputs[sets]]) / noise
    scale = np.repeat([1.0, 1 / model.units.span], half)
    return Seen(states, weight, shared.copy(), pins, model.layout.scale, scale)


def descended(fit: SpringFit, loose: float, effort: Effort = THOROUGH) -> SpringFit:
    """The fit after its ties were tightened in stages, from `loose` on."""
    half = fit.model.free.size // 2
    tightest = effort.tightest * fit.noise
    for tie in np.geomspace(max(loose, tightest), tightest, effort.stages):
        model = replace(fit.model, bond=float(tie))
        ties = np.repeat([tie, tie / fit.model.units.span], half)
        chain = begin(model, fit.seen, fit.chain.states, fit.chain.shared, ties)
        chain = relaxed(model, fit.seen, chain, effort.last if tie == tightest else effort.iterations)
        fit = replace(fit, model=model, chain=chain)
    return fit


def from_slack(fit: SpringFit) -> SpringFit:
    """The fit told that no spring is stretched at its first sample; not yet descended."""
    return replace(fit, model=replace(fit.model, slack=True))


def from_rest(fit: SpringFit) -> SpringFit:
    """The fit told that nothing moves at its first sample; not yet descended."""
    half = fit.model.free.size // 2
    states, weight = fit.seen.states.copy(), fit.seen.weight.copy()
    states[0, half:] = 0.0
    weight[0, half:] = fit.model.units.span / (REST * fit.model.units.length)
    return replace(fit, seen=replace(fit.seen, states=states, weight=weight))


def residuals(fit: SpringFit) -> FloatArray:
    """(T, S / 2) fitted minus seen places of free particles; NaN where they were not seen."""
    half = fit.chain.states.shape[1] // 2
    off = fit.chain.states[:, :half] - fit.seen.states[:, :half]
    return np.where(fit.seen.weight[:, :half] > 0, off, np.nan)


def covariance(fit: SpringFit) -> FloatArray:
    """(P, P) of the shared coordinates."""
    known = information(normal_equations(fit.seen, fit.chain))
    size = 1 / np.sqrt(np.diag(known).clip(1e-300))
    return np.asarray(np.linalg.pinv(known * size * size[:, None], hermitian=True) * size * size[:, None])
