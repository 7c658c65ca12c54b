"""Cost and normal equations of a multiple-shooting problem at one iterate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_problem import (
    NOT_SIMULATED,
    ChainIterate,
    Iterate,
    ShootingProblem,
    embed_chain,
    extract_chain,
    map_chains,
    prior_cost,
    replace_chains,
    value_derivatives,
)
from models.estimation.multiple_shooting.shooting_windows import (
    LinearizedWindow,
    ShootingModel,
    SimulatedWindow,
    Window,
    copy_contiguous,
    linearize_window,
    simulate_window,
)
from models.estimation.multiple_shooting.state_elimination import ChainBlock
from models.numerics.statistics import evaluate_huber_loss


def linearize_chains(problem: ShootingProblem, point: Iterate) -> tuple[Iterate, list[ChainBlock]]:
    """Linearize all windows of an iterate and assemble the normal equations of every chain.

    Args:
        problem: Problem to linearize.
        point: Iterate at which to linearize.

    Returns:
        The iterate with all Jacobians, and one block of normal equations per chain.
    """
    chains = range(len(problem.chains))
    results = map_chains(problem, _linearize_chain_task, point, chains)
    parts = {chain: part for chain, (part, _) in zip(chains, results, strict=True)}
    return replace_chains(problem, point, parts), [block for _, block in results]


def _linearize_chain_task(
    problem: ShootingProblem, part: ChainIterate, shared: FloatArray, chain: int
) -> tuple[ChainIterate, ChainBlock]:
    point = linearize_windows(problem, embed_chain(problem, part, shared, chain), chain)
    linearized = extract_chain(problem, point, chain)
    return replace(linearized, windows=tuple(map(copy_contiguous, linearized.windows))), assemble_chain_block(
        problem, point, chain
    )


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
    chains = range(len(problem.chains))
    parts = map_chains(problem, _simulate_chain_task, point, chains)
    point = replace_chains(problem, point, dict(zip(chains, parts, strict=True)))
    point.costs[-1] = prior_cost(problem.model.unknowns, shared)
    return point


def _simulate_chain_task(problem: ShootingProblem, part: ChainIterate, shared: FloatArray, chain: int) -> ChainIterate:
    own = zip(problem.chains[chain], part.starts, strict=True)
    predictions = tuple(copy_contiguous(simulate_window(problem.model, k, start, shared)) for k, start in own)
    point = embed_chain(problem, replace(part, windows=predictions), shared, chain)
    return ChainIterate(part.starts, predictions, chain_cost(problem, point, chain))


def linearize_windows(
    problem: ShootingProblem, point: Iterate, chain: int, model: ShootingModel | None = None
) -> Iterate:
    """Linearize those windows of one chain that have no Jacobians yet, by `model` where it is given."""
    predictions, model = list(point.windows), problem.model if model is None else model
    for k in problem.chains[chain]:
        if isinstance(predictions[k], SimulatedWindow):
            predictions[k] = linearize_window(model, k, point.starts[k], point.shared)
    return replace(point, windows=tuple(predictions))


def count_first_observations(window: Window, share: float) -> int:
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
        cost += evaluate_huber_loss(prediction.residual[: count_first_observations(window, share)])[1]
        cost += float((((point.starts[k] - window.start) / window.sigma) ** 2).sum())
        if window.link_sigma is not None:
            cost += float((((point.starts[k] - point.windows[k - 1].end) / window.link_sigma) ** 2).sum())
    return cost if np.isfinite(cost) else float("inf")


def assemble_normal_equations(problem: ShootingProblem, point: Iterate) -> list[ChainBlock]:
    """Assemble the normal equations of every chain."""
    return map_chains(problem, _assemble_chain_task, point, range(len(problem.chains)))


def _assemble_chain_task(problem: ShootingProblem, part: ChainIterate, shared: FloatArray, chain: int) -> ChainBlock:
    return assemble_chain_block(problem, embed_chain(problem, part, shared, chain), chain)


def assemble_chain_block(problem: ShootingProblem, point: Iterate, chain: int) -> ChainBlock:
    """Assemble the normal equations of one chain: states, shared search coordinates, and their coupling."""
    scale = value_derivatives(problem.model.unknowns, point.shared)
    return _assemble_block(problem, linearize_windows(problem, point, chain), chain, 1.0, scale)


def assemble_state_block(problem: ShootingProblem, point: Iterate, chain: int, share: float) -> ChainBlock:
    """Assemble the normal equations of the states of one chain alone, of the first `share` of its windows."""
    return _assemble_block(
        problem, linearize_windows(problem, point, chain, problem.state_model), chain, share, np.empty(0)
    )


def _assemble_block(
    problem: ShootingProblem, point: Iterate, chain: int, share: float, scale: FloatArray
) -> ChainBlock:
    """Assemble the block of one chain.

    Args:
        problem: Problem to linearize.
        point: Iterate whose windows of this chain are linearized.
        chain: Index of the chain.
        share: Share of each window's duration that is used.
        scale: (P,) derivatives of the shared parameters by their search coordinates; may be empty.

    Returns:
        Normal equations of the states and the first `len(scale)` shared coordinates.
    """
    numbers = problem.chains[chain]
    offsets = np.concatenate([[0], np.cumsum([len(point.starts[k]) for k in numbers])])
    block = ChainBlock.empty(int(offsets[-1]), len(scale))
    for place, k in enumerate(numbers):
        window, linearized = problem.windows[k], require_linearized(point, k)
        here = slice(offsets[place], offsets[place + 1])
        count = count_first_observations(window, share)
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
    """Add the continuity of the start of window `k` with the end of the previous window."""
    tied = np.flatnonzero(np.isfinite(sigma))
    prediction = require_linearized(point, k - 1)
    rows = np.zeros((len(tied), here.stop - before.start))
    rows[:, : here.start - before.start] = -prediction.end_start_jacobian[tied]
    rows[np.arange(len(tied)), here.start - before.start + tied] = 1.0
    rows /= sigma[tied, None]
    shared = -prediction.end_shared_jacobian[tied, : len(scale)] * scale / sigma[tied, None]
    both = slice(before.start, here.stop)
    block.add_rows(both, rows, shared, ((point.starts[k] - prediction.end) / sigma)[tied])
