"""A multiple-shooting problem, its iterates, and their cost and normal equations, chain by chain.

A chain is a sequence of windows in which each one starts where the one before it ends, within a tolerance. Chains share
nothing but the shared parameters, so that the cost of a fit grows linearly with their number, however many of them
belong to one shot.

Shared parameters are searched by their logarithms where their prior is relative.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import (
    LinearizedWindow,
    ShootingModel,
    SimulatedWindow,
    Window,
    copy_contiguous,
    drop_shared_jacobian,
    linearize_window,
    simulate_ahead,
    simulate_window,
)
from models.estimation.multiple_shooting.state_elimination import ChainBlock
from models.numerics.executor import SERIAL, Executor
from models.numerics.statistics import evaluate_huber_loss
from models.physics.effect import Prior

# Relative gain of a step below which a search ends.
LEAST_GAIN = 1e-6
# Chains that a model simulates together in one task, where it can.
_CHAINS_TOGETHER = 16
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
    least_gain: float = LEAST_GAIN
    """Relative gain of a step below which a search ends."""
    state_model: ShootingModel = field(init=False, repr=False)
    """Model for steps of the start states alone; it may leave out Jacobians by the shared parameters."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "state_model", drop_shared_jacobian(self.model))

    def __reduce__(self) -> tuple[Callable[..., ShootingProblem], tuple[ShootingModel, Executor, float]]:
        """Pickle without the executor: a worker process works alone."""
        return build_problem, (self.model, SERIAL, self.least_gain)


def build_problem(model: ShootingModel, executor: Executor = SERIAL, least_gain: float = LEAST_GAIN) -> ShootingProblem:
    """Group the windows of a model into chains.

    Args:
        model: Model to fit.
        executor: Distributes the chains over processes.
        least_gain: Relative gain of a step below which a search ends.

    Returns:
        The problem that a fit works on.
    """
    windows = model.windows
    firsts = [k for k, window in enumerate(windows) if window.link_sigma is None]
    chains = tuple(tuple(range(first, end)) for first, end in pairwise([*firsts, len(windows)]))
    return ShootingProblem(model, windows, chains, executor, least_gain)


@dataclass(frozen=True, slots=True)
class ChainIterate:
    """The part of an iterate that belongs to one chain: one entry per window, in their order."""

    starts: tuple[FloatArray, ...]
    windows: tuple[LinearizedWindow | SimulatedWindow, ...]
    cost: float


@dataclass(frozen=True, slots=True)
class WindowRequest:
    """Windows that a task on a chain wants to have predicted."""

    model: ShootingModel
    windows: tuple[int, ...]
    """Indices of the windows."""
    point: Iterate
    """Start states and shared parameters."""
    has_jacobians: bool


Prediction = LinearizedWindow | SimulatedWindow
Result = TypeVar("Result")
# Work on one chain that waits for predictions of windows and returns a result.
ChainTask = Generator[WindowRequest, list[Prediction], Result]


def map_chains(
    problem: ShootingProblem,
    work: Callable[..., ChainTask[tuple[Iterate, Result]]],
    point: Iterate,
    chains: Sequence[int],
    *more: Any,
) -> tuple[Iterate, list[Result]]:
    """Run one task per chain through the executor; where a model simulates windows together, several side by side.

    Args:
        problem: Problem that the iterate belongs to.
        work: Function `work(problem, point, chain, *more)`, importable in a worker process: a task that returns an
            iterate of which this chain counts, and a result. Other chains of its `point` are not simulated.
        point: Iterate to change; it stays as it is.
        chains: Indices of the chains to work on.
        more: Further arguments of every task.

    Returns:
        The changed iterate, and the results in the order of `chains`.
    """
    # a model that cannot simulate windows together gains nothing from groups
    size = _CHAINS_TOGETHER if getattr(problem.model, "simulates_together", False) else 1
    groups = [chains[first : first + size] for first in range(0, len(chains), size)]
    jobs = [([_extract_chain(problem, point, chain) for chain in own], point.shared, own, work, *more)
            for own in groups]  # fmt: skip
    done = problem.executor.map_tasks(problem, _work_on_group, jobs)
    parts = {chain: part for own, (ends, _) in zip(groups, done, strict=True)
             for chain, part in zip(own, ends, strict=True)}  # fmt: skip
    return _replace_chains(problem, point, parts), [result for _, results in done for result in results]


def _work_on_group(
    problem: ShootingProblem,
    parts: list[ChainIterate],
    shared: FloatArray,
    chains: Sequence[int],
    work: Callable[..., ChainTask[tuple[Iterate, Result]]],
    *more: Any,
) -> tuple[list[ChainIterate], list[Result]]:
    """Run the tasks of some chains side by side."""
    starts = tuple(window.start for window in problem.windows)
    blank = Iterate(starts, shared, (NOT_SIMULATED,) * len(starts), np.zeros(len(problem.chains) + 1))
    point = _replace_chains(problem, blank, dict(zip(chains, parts, strict=True)))
    ends = _run_side_by_side([work(problem, point, chain, *more) for chain in chains])
    own = [_extract_chain(problem, end, chain) for chain, (end, _) in zip(chains, ends, strict=True)]
    whole = [replace(one, windows=tuple(map(copy_contiguous, one.windows))) for one in own]
    return whole, [result for _, result in ends]


def _run_side_by_side(tasks: Sequence[ChainTask[Result]]) -> list[Result]:
    """Run tasks to their ends: what all of them wait for is simulated together."""
    results = dict[int, Result]()
    answers: dict[int, list[Prediction] | None] = dict.fromkeys(range(len(tasks)))
    while answers:
        requests = dict[int, WindowRequest]()
        for k, answer in answers.items():
            try:
                requests[k] = next(tasks[k]) if answer is None else tasks[k].send(answer)
            except StopIteration as end:
                results[k] = end.value
        answers = dict(zip(requests, _answer_requests(list(requests.values())), strict=True))
    return [results[k] for k in range(len(tasks))]


def _answer_requests(requests: list[WindowRequest]) -> list[list[Prediction]]:
    """Predict the windows of several requests, together where they are of one model that can."""
    answers: list[list[Prediction]] = [[] for _ in requests]
    for kind in {(id(one.model), one.has_jacobians) for one in requests}:
        alike = [k for k, one in enumerate(requests) if (id(one.model), one.has_jacobians) == kind]
        cases = [(k, window, requests[k].point) for k in alike for window in requests[k].windows]
        model, has_jacobians = requests[alike[0]].model, requests[alike[0]].has_jacobians
        starts, shared = [point.starts[window] for _, window, point in cases], [one.shared for _, _, one in cases]
        ahead = simulate_ahead(model, [window for _, window, _ in cases], starts, shared, has_jacobians)
        predict = linearize_window if has_jacobians else simulate_window
        for k, window, point in cases:
            answers[k].append(predict(ahead, window, point.starts[window], point.shared))
    return answers


def _predict_windows(
    model: ShootingModel, point: Iterate, windows: tuple[int, ...], has_jacobians: bool
) -> ChainTask[Iterate]:
    """Return an iterate with predictions of these windows."""
    predictions = list(point.windows)
    if windows:
        own = yield WindowRequest(model, windows, point, has_jacobians)
        for k, one in zip(windows, own, strict=True):
            predictions[k] = one
    return replace(point, windows=tuple(predictions))


def _extract_chain(problem: ShootingProblem, point: Iterate, chain: int) -> ChainIterate:
    own = problem.chains[chain]
    return ChainIterate(
        tuple(point.starts[k] for k in own), tuple(point.windows[k] for k in own), float(point.costs[chain])
    )


def _replace_chains(problem: ShootingProblem, point: Iterate, parts: Mapping[int, ChainIterate]) -> Iterate:
    starts, predictions, costs = list(point.starts), list(point.windows), point.costs.copy()
    for chain, part in parts.items():
        for k, start, prediction in zip(problem.chains[chain], part.starts, part.windows, strict=True):
            starts[k], predictions[k] = start, prediction
        costs[chain] = part.cost
    return Iterate(tuple(starts), point.shared, tuple(predictions), costs)


def simulate_chains(problem: ShootingProblem, starts: tuple[FloatArray, ...], shared: FloatArray) -> Iterate:
    """Simulate every window, without Jacobians where the model can leave them out.

    Args:
        problem: Problem to simulate.
        starts: (S,) start state of each window.
        shared: (P,) shared parameters.

    Returns:
        The iterate at these values.
    """
    point = Iterate(starts, shared, (NOT_SIMULATED,) * len(starts), np.zeros(len(problem.chains) + 1))
    point, _ = map_chains(problem, _simulate_chain_task, point, range(len(problem.chains)))
    point.costs[-1] = prior_cost(problem.model.unknowns, shared)
    return point


def _simulate_chain_task(problem: ShootingProblem, point: Iterate, chain: int) -> ChainTask[tuple[Iterate, None]]:
    return (yield from simulate_chain(problem, point, chain, point.starts)), None


def simulate_chain(
    problem: ShootingProblem, point: Iterate, chain: int, starts: tuple[FloatArray, ...]
) -> ChainTask[Iterate]:
    """Replace the start states of one chain by those of `starts` and simulate it."""
    costs = point.costs.copy()
    moved = Iterate(starts, point.shared, point.windows, costs)
    simulated = yield from _predict_windows(problem.model, moved, problem.chains[chain], has_jacobians=False)
    costs[chain] = chain_cost(problem, simulated, chain)
    return simulated


def linearize_chains(problem: ShootingProblem, point: Iterate) -> tuple[Iterate, list[ChainBlock]]:
    """Linearize all windows of an iterate and assemble the normal equations of every chain.

    Args:
        problem: Problem to linearize.
        point: Iterate at which to linearize.

    Returns:
        The iterate with all Jacobians, and one block of normal equations per chain.
    """
    return map_chains(problem, _linearize_chain_task, point, range(len(problem.chains)), True)


def assemble_normal_equations(problem: ShootingProblem, point: Iterate) -> list[ChainBlock]:
    """Assemble the normal equations of every chain: states, shared search coordinates, and their coupling."""
    return map_chains(problem, _linearize_chain_task, point, range(len(problem.chains)), False)[1]


def _linearize_chain_task(
    problem: ShootingProblem, point: Iterate, chain: int, keeps_jacobians: bool
) -> ChainTask[tuple[Iterate, ChainBlock]]:
    scale = value_derivatives(problem.model.unknowns, point.shared)
    linearized = yield from _linearize_windows(problem, point, chain, problem.model)
    block = _assemble_block(problem, linearized, chain, 1.0, scale)
    return linearized if keeps_jacobians else point, block


def _linearize_windows(
    problem: ShootingProblem, point: Iterate, chain: int, model: ShootingModel
) -> ChainTask[Iterate]:
    """Linearize those windows of one chain that have no Jacobians yet."""
    missing = tuple(k for k in problem.chains[chain] if isinstance(point.windows[k], SimulatedWindow))
    return (yield from _predict_windows(model, point, missing, has_jacobians=True))


def _count_first_observations(window: Window, share: float) -> int:
    """Count the observations within the first `share` of a window's duration."""
    if share >= 1.0 or len(window.t) == 0:
        return len(window.t)
    first, last = window.t[0], window.t[-1]
    return int(np.searchsorted(window.t, first + share * (last - first), side="right"))


def chain_cost(problem: ShootingProblem, point: Iterate, chain: int, share: float = 1.0) -> float:
    """Compute the robust chi2 of the first `share` of a chain's windows, with the priors and links of its states."""
    cost = 0.0
    for k in problem.chains[chain]:
        window, prediction = problem.windows[k], point.windows[k]
        cost += evaluate_huber_loss(prediction.residual[: _count_first_observations(window, share)])[1]
        cost += float((((point.starts[k] - window.start) / window.sigma) ** 2).sum())
        if window.link_sigma is not None:
            cost += float((((point.starts[k] - point.windows[k - 1].end) / window.link_sigma) ** 2).sum())
    return cost if np.isfinite(cost) else float("inf")


def assemble_state_block(problem: ShootingProblem, point: Iterate, chain: int, share: float) -> ChainTask[ChainBlock]:
    """Assemble the normal equations of the states of one chain alone, of the first `share` of its windows."""
    linearized = yield from _linearize_windows(problem, point, chain, problem.state_model)
    return _assemble_block(problem, linearized, chain, share, np.empty(0))


def _assemble_block(
    problem: ShootingProblem, point: Iterate, chain: int, share: float, scale: FloatArray
) -> ChainBlock:
    """Assemble the normal equations of the states of a linearized chain and the first `len(scale)` shared coordinates.

    `scale` (P,) are the derivatives of the shared parameters by their search coordinates; it may be empty.
    """
    numbers = problem.chains[chain]
    offsets = np.concatenate([[0], np.cumsum([len(point.starts[k]) for k in numbers])])
    block = ChainBlock.empty(int(offsets[-1]), len(scale))
    for place, k in enumerate(numbers):
        window, linearized = problem.windows[k], require_linearized(point, k)
        here = slice(offsets[place], offsets[place + 1])
        count = _count_first_observations(window, share)
        weight = np.sqrt(evaluate_huber_loss(linearized.residual[:count])[0])[:, None]
        by_start = (linearized.start_jacobian[:count] * weight[:, :, None]).reshape(-1, len(point.starts[k]))
        by_shared = linearized.shared_jacobian[:count, :, : len(scale)] * weight[:, :, None]
        by_shared = by_shared.reshape(len(by_start), len(scale)) * scale
        block.add_rows(here, by_start, by_shared, (linearized.residual[:count] * weight).reshape(-1))
        block.add_prior(here, point.starts[k] - window.start, window.sigma)
        if window.link_sigma is not None:
            _add_link(block, here, slice(offsets[place - 1], offsets[place]), window.link_sigma, point, k, scale)
    return block


def require_linearized(point: Iterate, k: int) -> LinearizedWindow:
    """Return a window of an iterate with its Jacobians.

    Args:
        point: Iterate that should be linearized.
        k: Index of the window.

    Returns:
        The linearized window.

    Raises:
        ValueError: The window has no Jacobians.
    """
    prediction = point.windows[k]
    if isinstance(prediction, SimulatedWindow):
        raise ValueError(f"the Jacobians of window {k} are needed; it was simulated without them")
    return prediction


def _add_link(
    block: ChainBlock, here: slice, before: slice, sigma: FloatArray, point: Iterate, k: int, scale: FloatArray
) -> None:
    """Add the constraint that window `k` starts, within `sigma`, in the state in which the window before it ends."""
    tied = np.flatnonzero(np.isfinite(sigma))
    prediction = require_linearized(point, k - 1)
    rows = np.zeros((len(tied), here.stop - before.start))
    rows[:, : here.start - before.start] = -prediction.end_start_jacobian[tied]
    rows[np.arange(len(tied)), here.start - before.start + tied] = 1.0
    rows /= sigma[tied, None]
    shared = -prediction.end_shared_jacobian[tied, : len(scale)] * scale / sigma[tied, None]
    both = slice(before.start, here.stop)
    block.add_rows(both, rows, shared, ((point.starts[k] - prediction.end) / sigma)[tied])


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
