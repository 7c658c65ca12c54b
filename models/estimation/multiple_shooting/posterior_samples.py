"""Starts and shared numbers of one shot as a fit leaves them open: drawn from what it knows, its priors among that."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.normal_equations import glanced, sloped_everywhere
from models.estimation.multiple_shooting.shared_parameters import bounds, prior_knowledge, values_of
from models.estimation.multiple_shooting.shooting_problem import Problem
from models.estimation.multiple_shooting.shooting_windows import Model
from models.estimation.multiple_shooting.state_elimination import LEAST_KNOWN

Starts = tuple[FloatArray, ...]


def drawn(
    model: Model, starts: Starts, shared: FloatArray, count: int, wider: float, rng: np.random.Generator
) -> list[tuple[Starts, FloatArray]]:
    """`count` starts and shared numbers about a fit of one shot, `wider` times as far off as it leaves them open.

    Gaussian in the coordinates of the search: what is far from linear, such as which ball is met first, differs
    between the draws.
    """
    problem = Problem(model, model.windows, (tuple(range(len(model.windows))),))
    _, (block,) = sloped_everywhere(problem, glanced(problem, starts, shared))
    size = len(block.gradient)
    whole = np.block([[block.states, block.coupling], [block.coupling.T, block.shared]])
    whole[size:, size:] += np.diag(prior_knowledge(model.unknowns, shared)[1])
    steps = wider * _noise(whole, count, rng)
    middle, low, high = bounds(model.unknowns, shared)
    edges = np.cumsum([len(start) for start in starts])[:-1]
    return [
        (
            tuple(start + part for start, part in zip(starts, np.split(step[:size], edges), strict=True)),
            values_of(model.unknowns, np.clip(middle + step[size:], low, high)),
        )
        for step in steps
    ]


def _noise(information: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, M) normal numbers whose inverse covariance is `information` (M, M); what nothing tells stays."""
    scale = np.sqrt(np.maximum(np.diag(information), LEAST_KNOWN))
    sizes, axes = np.linalg.eigh(information / scale / scale[:, None])
    spread = np.where(sizes > len(sizes) * np.finfo(float).eps, 1 / np.sqrt(np.maximum(sizes, 1e-300)), 0.0)
    drawn: FloatArray = (rng.standard_normal((count, len(sizes))) * spread) @ axes.T / scale
    return drawn
