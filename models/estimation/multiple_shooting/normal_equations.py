"""One place in the search of the fit by shooting: what it costs, and its normal equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shared_parameters import prior_cost, slopes
from models.estimation.multiple_shooting.shooting_problem import (
    UNSEEN,
    Attempt,
    Part,
    Problem,
    by_shot,
    of_part,
    part_of,
    with_parts,
)
from models.estimation.multiple_shooting.shooting_windows import Flow, Glance, Model, Window, glance, in_order
from models.estimation.multiple_shooting.state_elimination import ShotBlock
from models.numerics.jit import compiled

HUBER = 2.5
"""standard deviations where the loss of an observation turns linear."""


def sloped_everywhere(problem: Problem, point: Attempt) -> tuple[Attempt, list[ShotBlock]]:
    """An attempt with all slopes, and the normal equations of every shot."""
    shots = range(len(problem.shots))
    found = by_shot(problem, _sloped_part, point, shots)
    parts = {shot: part for shot, (part, _) in zip(shots, found, strict=True)}
    return with_parts(problem, point, parts), [block for _, block in found]


def _sloped_part(problem: Problem, part: Part, shared: FloatArray, shot: int) -> tuple[Part, ShotBlock]:
    point = with_slopes(problem, of_part(problem, part, shared, shot), shot)
    sloped = part_of(problem, point, shot)
    return replace(sloped, flows=tuple(map(in_order, sloped.flows))), normal_block(problem, point, shot)


def glanced(problem: Problem, starts: tuple[FloatArray, ...], shared: FloatArray) -> Attempt:
    """Simulate every window, without slopes where the model can leave them out."""
    point = Attempt(starts, shared, (UNSEEN,) * len(starts), np.zeros(len(problem.shots) + 1))
    shots = range(len(problem.shots))
    parts = by_shot(problem, _glanced_part, point, shots)
    point = with_parts(problem, point, dict(zip(shots, parts, strict=True)))
    point.costs[-1] = prior_cost(problem.model.unknowns, shared)
    return point


def _glanced_part(problem: Problem, part: Part, shared: FloatArray, shot: int) -> Part:
    own = zip(problem.shots[shot], part.starts, strict=True)
    flows = tuple(in_order(glance(problem.model, k, start, shared)) for k, start in own)
    point = of_part(problem, replace(part, flows=flows), shared, shot)
    return Part(part.starts, flows, shot_cost(problem, point, shot))


def with_slopes(problem: Problem, point: Attempt, shot: int, model: Model | None = None) -> Attempt:
    """The same, the windows of one shot with their slopes, as `model` has them where it is given."""
    flows, model = list(point.flows), problem.model if model is None else model
    for k in problem.shots[shot]:
        if isinstance(flows[k], Glance):
            flows[k] = model.flow(k, point.starts[k], point.shared)
    return replace(point, flows=tuple(flows))


def first_share(window: Window, share: float) -> int:
    """How many observations lie in the first `share` of a window's time."""
    if share >= 1.0 or len(window.t) == 0:
        return len(window.t)
    first, last = window.t[0], window.t[-1]
    return int(np.searchsorted(window.t, first + share * (last - first), side="right"))


def huber(misfit: FloatArray) -> tuple[FloatArray, float]:
    """Weight of each observation (K,) and cost of misfits (K, d); a flow that is not finite costs infinitely much."""
    weight, loss = np.empty(len(misfit)), np.empty(len(misfit))
    if not _bounded(misfit, weight, loss):
        return np.zeros(len(misfit)), float("inf")
    return weight, float(loss.sum())


@compiled
def _bounded(misfit, weight, loss):  # type: ignore[no-untyped-def]
    """Fill weight (K,) and loss (K,) of misfits (K, d); whether all of these are finite."""
    for k in range(len(misfit)):
        square = 0.0
        for one in misfit[k]:
            if not np.isfinite(one):
                return False
            square += one * one
        size = np.sqrt(square)
        inner = min(size, HUBER)
        weight[k] = HUBER / size if size > HUBER else 1.0
        loss[k] = 2 * size * inner - inner * inner
    return True


def shot_cost(problem: Problem, point: Attempt, shot: int, share: float = 1.0) -> float:
    """Robust chi2 of the first `share` of a shot's windows, with what is known of its states."""
    cost = 0.0
    for k in problem.shots[shot]:
        window, flow = problem.windows[k], point.flows[k]
        cost += huber(flow.misfit[: first_share(window, share)])[1]
        cost += float((((point.starts[k] - window.start) / window.sigma) ** 2).sum())
        if window.link is not None:
            cost += float((((point.starts[k] - point.flows[k - 1].end) / window.link) ** 2).sum())
    return cost if np.isfinite(cost) else float("inf")


def normal_blocks(problem: Problem, point: Attempt) -> list[ShotBlock]:
    """Normal equations of every shot."""
    return by_shot(problem, _block_of_part, point, range(len(problem.shots)))


def _block_of_part(problem: Problem, part: Part, shared: FloatArray, shot: int) -> ShotBlock:
    return normal_block(problem, of_part(problem, part, shared, shot), shot)


def normal_block(problem: Problem, point: Attempt, shot: int) -> ShotBlock:
    """Normal equations of one shot: its states, the shared coordinates, and what couples them."""
    scale = slopes(problem.model.unknowns, point.shared)
    return _block(problem, with_slopes(problem, point, shot), shot, 1.0, scale)


def states_block(problem: Problem, point: Attempt, shot: int, share: float) -> ShotBlock:
    """Normal equations of the states of one shot alone, of the first `share` of its windows."""
    return _block(problem, with_slopes(problem, point, shot, problem.of_states), shot, share, np.empty(0))


def _block(problem: Problem, point: Attempt, shot: int, share: float, scale: FloatArray) -> ShotBlock:
    """Of the first `share` of the windows of a shot, by its states and the first shared numbers; `scale` (P,) are the
    slopes of these by their coordinates."""
    numbers = problem.shots[shot]
    offsets = np.concatenate([[0], np.cumsum([len(point.starts[k]) for k in numbers])])
    block = ShotBlock.empty(int(offsets[-1]), len(scale))
    for place, k in enumerate(numbers):
        window, flow = problem.windows[k], sloped(point, k)
        here = slice(offsets[place], offsets[place + 1])
        seen = first_share(window, share)
        weight = np.sqrt(huber(flow.misfit[:seen])[0])[:, None]
        by_start = (flow.by_start[:seen] * weight[:, :, None]).reshape(-1, len(point.starts[k]))
        by_shared = flow.by_shared[:seen, :, : len(scale)] * weight[:, :, None]
        by_shared = by_shared.reshape(len(by_start), len(scale)) * scale
        block.add(here, by_start, by_shared, (flow.misfit[:seen] * weight).reshape(-1))
        block.know(here, point.starts[k] - window.start, window.sigma)
        if window.link is not None:
            _link(block, here, slice(offsets[place - 1], offsets[place]), window.link, point, k, scale)
    return block


def sloped(point: Attempt, k: int) -> Flow:
    """A flow that has its slopes."""
    flow = point.flows[k]
    if isinstance(flow, Glance):
        raise ValueError(f"slopes are needed; window {k} has none")
    return flow


def _link(
    block: ShotBlock, here: slice, before: slice, sigma: FloatArray, point: Attempt, k: int, scale: FloatArray
) -> None:
    """Continuity of the start of window `k` with the end of the window before."""
    tied = np.flatnonzero(np.isfinite(sigma))
    flow = sloped(point, k - 1)
    rows = np.zeros((len(tied), len(block.gradient)))
    rows[:, here] = np.eye(len(sigma))[tied]
    rows[:, before] = -flow.end_by_start[tied]
    rows /= sigma[tied, None]
    shared = -flow.end_by_shared[tied, : len(scale)] * scale / sigma[tied, None]
    block.add(slice(None), rows, shared, ((point.starts[k] - flow.end) / sigma)[tied])
