"""The fixed data of a multiple-shooting fit, its current iterate, and the part of both that belongs to one chain.

A chain is a window with those that are linked to it by continuity. Chains share nothing but the shared parameters, so
that the cost of a fit grows linearly with their number, however many of them belong to one shot.

Shared parameters are searched by their logarithms where their prior is relative.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import (
    LinearizedWindow,
    ShootingModel,
    SimulatedWindow,
    Window,
    drop_shared_jacobian,
)
from models.numerics.executor import SERIAL, Executor
from models.physics.effect import Prior

# Stands for a window that was not simulated.
NOT_SIMULATED = SimulatedWindow(np.empty((0, 1)), np.empty(0))


@dataclass(frozen=True, slots=True)
class Iterate:
    """One point of the search: start states of all windows and shared parameters, with their simulation."""

    starts: tuple[FloatArray, ...]
    """(S,) start state of each window."""
    shared: FloatArray
    """(P,) shared parameters."""
    windows: tuple[LinearizedWindow | SimulatedWindow, ...]
    """Simulation of each window; linearized only where a step needed the Jacobians."""
    costs: FloatArray
    """(Q,) cost of each chain; the cost of the priors of the shared parameters comes last."""

    @property
    def cost(self) -> float:
        """Total cost: robust chi2 of the residuals and chi2 of all pseudo-observations."""
        return float(self.costs.sum())


@dataclass(frozen=True, slots=True)
class ShootingProblem:
    """What does not change during a fit."""

    model: ShootingModel
    windows: tuple[Window, ...]
    chains: tuple[tuple[int, ...], ...]
    """Indices of the windows of each chain, in the order of time."""
    executor: Executor = field(default=SERIAL, repr=False, compare=False)
    """Distributes the chains over processes."""
    state_model: ShootingModel = field(init=False, repr=False)
    """Model for steps of the start states alone; it may leave out Jacobians by the shared parameters."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "state_model", drop_shared_jacobian(self.model))

    def __reduce__(self) -> tuple[Callable[[ShootingModel], ShootingProblem], tuple[ShootingModel]]:
        """Pickle without the executor: a worker process works alone."""
        return build_problem, (self.model,)


def build_problem(model: ShootingModel, executor: Executor = SERIAL) -> ShootingProblem:
    """Group the windows of a model into chains.

    Args:
        model: Model to fit.
        executor: Distributes the chains over processes.

    Returns:
        The problem that a fit works on.
    """
    windows = model.windows
    firsts = [k for k, window in enumerate(windows) if window.link_sigma is None]
    chains = tuple(tuple(range(first, end)) for first, end in pairwise([*firsts, len(windows)]))
    return ShootingProblem(model, windows, chains, executor)


@dataclass(frozen=True, slots=True)
class ChainIterate:
    """The part of an iterate that belongs to one chain: one entry per window, in their order."""

    starts: tuple[FloatArray, ...]
    windows: tuple[LinearizedWindow | SimulatedWindow, ...]
    cost: float


def extract_chain(problem: ShootingProblem, point: Iterate, chain: int) -> ChainIterate:
    """Extract the part of an iterate that belongs to one chain."""
    own = problem.chains[chain]
    return ChainIterate(
        tuple(point.starts[k] for k in own), tuple(point.windows[k] for k in own), float(point.costs[chain])
    )


def replace_chains(problem: ShootingProblem, point: Iterate, parts: Mapping[int, ChainIterate]) -> Iterate:
    """Replace the parts of some chains in an iterate.

    Args:
        problem: Problem that the iterate belongs to.
        point: Iterate to change; it stays as it is.
        parts: New parts by the index of their chain.

    Returns:
        The changed iterate.
    """
    starts, predictions, costs = list(point.starts), list(point.windows), point.costs.copy()
    for chain, part in parts.items():
        for k, start, prediction in zip(problem.chains[chain], part.starts, part.windows, strict=True):
            starts[k], predictions[k] = start, prediction
        costs[chain] = part.cost
    return Iterate(tuple(starts), point.shared, tuple(predictions), costs)


def map_chains(
    problem: ShootingProblem, work: Callable[..., Any], point: Iterate, chains: Sequence[int], *more: Any
) -> list[Any]:
    """Run one task per chain through the executor.

    Args:
        problem: Problem that the iterate belongs to.
        point: Iterate whose parts the tasks receive.
        chains: Indices of the chains to work on.
        work: Function `work(problem, part, shared, chain, *more)`, importable in a worker process.
        more: Further arguments of every task.

    Returns:
        Results in the order of `chains`.
    """
    jobs = [(extract_chain(problem, point, chain), point.shared, chain, *more) for chain in chains]
    return problem.executor.map_tasks(problem, work, jobs)


def embed_chain(problem: ShootingProblem, part: ChainIterate, shared: FloatArray, chain: int) -> Iterate:
    """Build an iterate in which one chain is simulated; all others stay at their initial guess and cost nothing."""
    starts = [window.start for window in problem.windows]
    costs = np.zeros(len(problem.chains) + 1)
    point = Iterate(tuple(starts), shared, (NOT_SIMULATED,) * len(starts), costs)
    return replace_chains(problem, point, {chain: part})


def _search_coordinate(prior: Prior, value: float) -> float:
    """Convert a value of one parameter into its search coordinate."""
    return float(np.log(value)) if prior.relative else value


def _search_coordinates(unknowns: tuple[Prior, ...], shared: FloatArray) -> FloatArray:
    """Convert parameter values (P,) into search coordinates (P,)."""
    return np.array([_search_coordinate(prior, value) for prior, value in zip(unknowns, shared, strict=True)])


def values_from_coordinates(unknowns: tuple[Prior, ...], coordinates: FloatArray) -> FloatArray:
    """Convert search coordinates (P,) into parameter values (P,)."""
    return np.array([np.exp(q) if prior.relative else q for q, prior in zip(coordinates, unknowns, strict=True)])


def value_derivatives(unknowns: tuple[Prior, ...], shared: FloatArray) -> FloatArray:
    """Compute d value / d coordinate (P,) at the values `shared` (P,)."""
    return np.array([value if prior.relative else 1.0 for value, prior in zip(shared, unknowns, strict=True)])


def coordinate_bounds(unknowns: tuple[Prior, ...], shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute the coordinates (P,) of `shared` and of the lower and upper bounds."""
    low = np.array([_search_coordinate(prior, prior.bounds[0]) for prior in unknowns])
    high = np.array([_search_coordinate(prior, prior.bounds[1]) for prior in unknowns])
    return _search_coordinates(unknowns, shared), low, high


def prior_terms(unknowns: tuple[Prior, ...], shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute 1/sigma, information and gradient (P,) of the priors, in search coordinates."""
    scale = np.array([1 / prior.sigma for prior in unknowns])
    middle = np.array([_search_coordinate(prior, prior.value) for prior in unknowns])
    return scale, scale**2, scale**2 * (_search_coordinates(unknowns, shared) - middle)


def prior_cost(unknowns: tuple[Prior, ...], shared: FloatArray) -> float:
    """Compute chi2 of the values (P,) with respect to their priors."""
    scale, _, gradient = prior_terms(unknowns, shared)
    return float(np.square(gradient / scale).sum())
