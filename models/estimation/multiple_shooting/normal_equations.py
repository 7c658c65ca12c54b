"""Cost and normal equations of a multiple-shooting problem at one iterate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shared_parameters import prior_cost, value_derivatives
from models.estimation.multiple_shooting.shooting_problem import (
    NOT_SIMULATED,
    Iterate,
    ShootingProblem,
    ShotIterate,
    embed_shot,
    extract_shot,
    map_shots,
    replace_shots,
)
from models.estimation.multiple_shooting.shooting_windows import (
    LinearizedWindow,
    ShootingModel,
    SimulatedWindow,
    Window,
    copy_contiguous,
    simulate_window,
)
from models.estimation.multiple_shooting.state_elimination import ShotBlock
from models.numerics.robust import evaluate_huber_loss


def linearize_shots(problem: ShootingProblem, point: Iterate) -> tuple[Iterate, list[ShotBlock]]:
    """Linearize all windows of an iterate and assemble the normal equations of every shot.

    Args:
        problem: Problem to linearize.
        point: Iterate at which to linearize.

    Returns:
        The iterate with all Jacobians, and one block of normal equations per shot.
    """
    shots = range(len(problem.shot_windows))
    results = map_shots(problem, _linearize_shot_task, point, shots)
    parts = {shot: part for shot, (part, _) in zip(shots, results, strict=True)}
    return replace_shots(problem, point, parts), [block for _, block in results]


def _linearize_shot_task(
    problem: ShootingProblem, part: ShotIterate, shared: FloatArray, shot: int
) -> tuple[ShotIterate, ShotBlock]:
    point = linearize_windows(problem, embed_shot(problem, part, shared, shot), shot)
    linearized = extract_shot(problem, point, shot)
    return replace(linearized, windows=tuple(map(copy_contiguous, linearized.windows))), assemble_shot_block(
        problem, point, shot
    )


def simulate_shots(problem: ShootingProblem, starts: tuple[FloatArray, ...], shared: FloatArray) -> Iterate:
    """Simulate every window, without Jacobians where the model can leave them out.

    Args:
        problem: Problem to simulate.
        starts: (S,) start state of each window.
        shared: (P,) shared parameters.

    Returns:
        The iterate at these values.
    """
    point = Iterate(starts, shared, (NOT_SIMULATED,) * len(starts), np.zeros(len(problem.shot_windows) + 1))
    shots = range(len(problem.shot_windows))
    parts = map_shots(problem, _simulate_shot_task, point, shots)
    point = replace_shots(problem, point, dict(zip(shots, parts, strict=True)))
    point.costs[-1] = prior_cost(problem.model.unknowns, shared)
    return point


def _simulate_shot_task(problem: ShootingProblem, part: ShotIterate, shared: FloatArray, shot: int) -> ShotIterate:
    own = zip(problem.shot_windows[shot], part.starts, strict=True)
    predictions = tuple(copy_contiguous(simulate_window(problem.model, k, start, shared)) for k, start in own)
    point = embed_shot(problem, replace(part, windows=predictions), shared, shot)
    return ShotIterate(part.starts, predictions, shot_cost(problem, point, shot))


def linearize_windows(
    problem: ShootingProblem, point: Iterate, shot: int, model: ShootingModel | None = None
) -> Iterate:
    """Linearize those windows of one shot that have no Jacobians yet, by `model` where it is given."""
    predictions, model = list(point.windows), problem.model if model is None else model
    for k in problem.shot_windows[shot]:
        if isinstance(predictions[k], SimulatedWindow):
            predictions[k] = model.linearize(k, point.starts[k], point.shared)
    return replace(point, windows=tuple(predictions))


def count_first_observations(window: Window, share: float) -> int:
    """Count the observations within the first `share` of a window's duration."""
    if share >= 1.0 or len(window.t) == 0:
        return len(window.t)
    first, last = window.t[0], window.t[-1]
    return int(np.searchsorted(window.t, first + share * (last - first), side="right"))


def shot_cost(problem: ShootingProblem, point: Iterate, shot: int, share: float = 1.0) -> float:
    """Compute the robust chi2 of the first `share` of a shot's windows, with the priors and links of its states."""
    cost = 0.0
    for k in problem.shot_windows[shot]:
        window, prediction = problem.windows[k], point.windows[k]
        cost += evaluate_huber_loss(prediction.residual[: count_first_observations(window, share)])[1]
        cost += float((((point.starts[k] - window.start) / window.sigma) ** 2).sum())
        if window.link_sigma is not None:
            cost += float((((point.starts[k] - point.windows[k - 1].end) / window.link_sigma) ** 2).sum())
    return cost if np.isfinite(cost) else float("inf")


def assemble_normal_equations(problem: ShootingProblem, point: Iterate) -> list[ShotBlock]:
    """Assemble the normal equations of every shot."""
    return map_shots(problem, _assemble_shot_task, point, range(len(problem.shot_windows)))


def _assemble_shot_task(problem: ShootingProblem, part: ShotIterate, shared: FloatArray, shot: int) -> ShotBlock:
    return assemble_shot_block(problem, embed_shot(problem, part, shared, shot), shot)


def assemble_shot_block(problem: ShootingProblem, point: Iterate, shot: int) -> ShotBlock:
    """Assemble the normal equations of one shot: states, shared search coordinates, and their coupling."""
    scale = value_derivatives(problem.model.unknowns, point.shared)
    return _assemble_block(problem, linearize_windows(problem, point, shot), shot, 1.0, scale)


def assemble_state_block(problem: ShootingProblem, point: Iterate, shot: int, share: float) -> ShotBlock:
    """Assemble the normal equations of the states of one shot alone, of the first `share` of its windows."""
    return _assemble_block(
        problem, linearize_windows(problem, point, shot, problem.state_model), shot, share, np.empty(0)
    )


def _assemble_block(problem: ShootingProblem, point: Iterate, shot: int, share: float, scale: FloatArray) -> ShotBlock:
    """Assemble the block of one shot.

    Args:
        problem: Problem to linearize.
        point: Iterate whose windows of this shot are linearized.
        shot: Index of the shot.
        share: Share of each window's duration that is used.
        scale: (P,) derivatives of the shared parameters by their search coordinates; may be empty.

    Returns:
        Normal equations of the states and the first `len(scale)` shared coordinates.
    """
    numbers = problem.shot_windows[shot]
    offsets = np.concatenate([[0], np.cumsum([len(point.starts[k]) for k in numbers])])
    block = ShotBlock.empty(int(offsets[-1]), len(scale))
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
    block: ShotBlock, here: slice, before: slice, sigma: FloatArray, point: Iterate, k: int, scale: FloatArray
) -> None:
    """Add the continuity of the start of window `k` with the end of the previous window."""
    tied = np.flatnonzero(np.isfinite(sigma))
    prediction = require_linearized(point, k - 1)
    rows = np.zeros((len(tied), len(block.gradient)))
    rows[:, here] = np.eye(len(sigma))[tied]
    rows[:, before] = -prediction.end_start_jacobian[tied]
    rows /= sigma[tied, None]
    shared = -prediction.end_shared_jacobian[tied, : len(scale)] * scale / sigma[tied, None]
    block.add_rows(slice(None), rows, shared, ((point.starts[k] - prediction.end) / sigma)[tied])
