"""Samples of the posterior of one shot: start states and shared parameters."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.normal_equations import linearize_chains, simulate_chains
from models.estimation.multiple_shooting.shared_parameters import (
    coordinate_bounds,
    prior_terms,
    values_from_coordinates,
)
from models.estimation.multiple_shooting.shooting_problem import Iterate, ShootingProblem
from models.estimation.multiple_shooting.shooting_windows import ShootingModel
from models.numerics.least_squares import MIN_INFORMATION

Starts = tuple[FloatArray, ...]


def sample_posterior(
    model: ShootingModel, starts: Starts, shared: FloatArray, count: int, widening: float, rng: np.random.Generator
) -> list[tuple[Starts, FloatArray]]:
    """Draw start states and shared parameters from the Gaussian approximation of the posterior of one shot.

    The samples are Gaussian in the search coordinates; strongly nonlinear consequences, such as which ball is hit
    first, differ between samples.

    Args:
        model: Model of one shot.
        starts: (S,) fitted start state of each window.
        shared: (P,) fitted shared parameters.
        count: Number of samples.
        widening: Factor on the standard deviations of the posterior.
        rng: Random generator.

    Returns:
        Pairs of start states and shared parameters.
    """
    problem = ShootingProblem(model, model.windows, (tuple(range(len(model.windows))),))
    return _draw_around(problem, simulate_chains(problem, starts, shared), count, widening, rng)[0]


def weigh_posterior_samples(
    model: ShootingModel, starts: Starts, shared: FloatArray, count: int, widening: float, rng: np.random.Generator
) -> tuple[list[tuple[Starts, FloatArray]], FloatArray]:
    """Draw samples as `sample_posterior`, and weigh them by the costs that their simulations have.

    The logarithm of the mean weight corrects the Laplace approximation of the evidence: where a parameter has no effect
    at the best fit but a strong one elsewhere, the Gaussian approximation is far too wide.

    Args:
        model: Model of one shot.
        starts: (S,) fitted start state of each window.
        shared: (P,) fitted shared parameters.
        count: Number of samples.
        widening: Factor on the standard deviations of the posterior.
        rng: Random generator.

    Returns:
        The samples, and the logarithms (count,) of their weights: posterior over its Gaussian approximation.
    """
    problem = ShootingProblem(model, model.windows, (tuple(range(len(model.windows))),))
    best = simulate_chains(problem, starts, shared)
    samples, predicted = _draw_around(problem, best, count, widening, rng)
    costs = np.array([simulate_chains(problem, *one).cost for one in samples]) - best.cost
    return samples, -0.5 * (np.nan_to_num(costs, nan=np.inf) / widening**2 - predicted)


def _draw_around(
    problem: ShootingProblem, point: Iterate, count: int, widening: float, rng: np.random.Generator
) -> tuple[list[tuple[Starts, FloatArray]], FloatArray]:
    """Draw samples around a best fit; also return (count,) the costs over it that the Gaussian approximation predicts.

    These costs are divided by the square of `widening`.
    """
    unknowns = problem.model.unknowns
    _, (block,) = linearize_chains(problem, point)
    size = len(block.gradient)
    whole = np.block([[block.states, block.coupling], [block.coupling.T, block.shared]])
    whole[size:, size:] += np.diag(prior_terms(unknowns, point.shared)[1])
    steps = widening * _sample_gaussian(whole, count, rng)
    middle, low, high = coordinate_bounds(unknowns, point.shared)
    edges = np.cumsum([len(start) for start in point.starts])[:-1]
    samples = [
        (
            tuple(start + part for start, part in zip(point.starts, np.split(step[:size], edges), strict=True)),
            values_from_coordinates(unknowns, np.clip(middle + step[size:], low, high)),
        )
        for step in steps
    ]
    return samples, np.einsum("ki,ij,kj->k", steps, whole, steps) / widening**2


def _sample_gaussian(information: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw (count, M) Gaussian numbers with inverse covariance `information` (M, M), 0 along unobserved directions."""
    scale = np.sqrt(np.maximum(np.diag(information), MIN_INFORMATION))
    sizes, axes = np.linalg.eigh(information / scale / scale[:, None])
    spread = np.where(sizes > len(sizes) * np.finfo(float).eps, 1 / np.sqrt(np.maximum(sizes, 1e-300)), 0.0)
    samples: FloatArray = (rng.standard_normal((count, len(sizes))) * spread) @ axes.T / scale
    return samples
