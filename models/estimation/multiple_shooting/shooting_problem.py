"""The windows of a model by shots, a place in the search for their starts and shared numbers, and its parts by shot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import Flow, Glance, Model, Window, narrowed
from models.numerics.executor import ALONE, Crew

UNSEEN = Glance(np.empty((0, 1)), np.empty(0))
"""of a window that was not simulated."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """Starts of all windows and shared numbers, simulated."""

    starts: tuple[FloatArray, ...]
    """per window (S,)."""
    shared: FloatArray
    """(P,)"""
    flows: tuple[Flow | Glance, ...]
    """without slopes where none were asked for yet."""
    costs: FloatArray
    """per shot (Q,); the prior of the shared numbers comes last."""

    @property
    def cost(self) -> float:
        return float(self.costs.sum())


@dataclass(frozen=True, slots=True)
class Problem:
    """What does not change during a search."""

    model: Model
    windows: tuple[Window, ...]
    shots: tuple[tuple[int, ...], ...]
    """numbers of the windows of each shot."""
    crew: Crew = field(default=ALONE, repr=False, compare=False)
    """Who works through the shots."""
    of_states: Model = field(init=False, repr=False)
    """The model for steps of states alone."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "of_states", narrowed(self.model))

    def __reduce__(self) -> tuple[Callable[[Model], Problem], tuple[Model]]:
        """Who helps has no helper."""
        return problem_of, (self.model,)


def problem_of(model: Model, crew: Crew = ALONE) -> Problem:
    """The windows of a model, by shots."""
    windows = model.windows
    numbers = sorted({window.shot for window in windows})
    shots = tuple(tuple(k for k, w in enumerate(windows) if w.shot == n) for n in numbers)
    return Problem(model, windows, shots, crew)


@dataclass(frozen=True, slots=True)
class Part:
    """What an attempt makes of one shot: of each of its windows, in their order."""

    starts: tuple[FloatArray, ...]
    flows: tuple[Flow | Glance, ...]
    cost: float


def part_of(problem: Problem, point: Attempt, shot: int) -> Part:
    """One shot of an attempt."""
    own = problem.shots[shot]
    return Part(tuple(point.starts[k] for k in own), tuple(point.flows[k] for k in own), float(point.costs[shot]))


def with_parts(problem: Problem, point: Attempt, parts: Mapping[int, Part]) -> Attempt:
    """An attempt with some shots as `parts` have them, by their numbers."""
    starts, flows, costs = list(point.starts), list(point.flows), point.costs.copy()
    for shot, part in parts.items():
        for k, start, flow in zip(problem.shots[shot], part.starts, part.flows, strict=True):
            starts[k], flows[k] = start, flow
        costs[shot] = part.cost
    return Attempt(tuple(starts), point.shared, tuple(flows), costs)


def by_shot(problem: Problem, work: Callable[..., Any], point: Attempt, shots: Sequence[int], *more: Any) -> list[Any]:
    """`work(problem, part, shared, shot, *more)` of the part that each of these shots has in an attempt, shared out."""
    jobs = [(part_of(problem, point, shot), point.shared, shot, *more) for shot in shots]
    return problem.crew.each(problem, work, jobs)


def of_part(problem: Problem, part: Part, shared: FloatArray, shot: int) -> Attempt:
    """An attempt in which one shot is simulated; all others are as they are first guessed, and cost nothing."""
    starts = [window.start for window in problem.windows]
    costs = np.zeros(len(problem.shots) + 1)
    point = Attempt(tuple(starts), shared, (UNSEEN,) * len(starts), costs)
    return with_parts(problem, point, {shot: part})
