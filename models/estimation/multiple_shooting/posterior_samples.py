"""Samples of the posterior of one shot: start states and shared parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_problem import (
    Iterate,
    ShootingProblem,
    coordinate_bounds,
    linearize_chains,
    prior_terms,
    simulate_chains,
    values_from_coordinates,
)
from models.estimation.multiple_shooting.shooting_windows import ShootingModel
from models.numerics.least_squares import MIN_INFORMATION

Starts = tuple[FloatArray, ...]
# Samples of a chain that are left out: it starts at the best fit.
BURN_IN = 12
# Trials of one step; after so many the last sample counts again.
_MAX_SHRINKING = 25


@dataclass(frozen=True, slots=True)
class GaussianPosterior:
    """Gaussian approximation of the posterior of one shot about its best fit, and the true posterior beside it."""

    problem: ShootingProblem
    best: Iterate
    information: FloatArray
    """(M, M) of states and search coordinates at the best fit."""
    coordinates: tuple[FloatArray, FloatArray, FloatArray]
    """(P,) search coordinates at the best fit, and their bounds."""
    widening: float
    """Factor on the standard deviations of both."""

    @classmethod
    def around_fit(cls, model: ShootingModel, starts: Starts, shared: FloatArray, widening: float) -> GaussianPosterior:
        """Build the approximation about a fit with start states and shared parameters (P,)."""
        problem = ShootingProblem(model, model.windows, (tuple(range(len(model.windows))),))
        best, (block,) = linearize_chains(problem, simulate_chains(problem, starts, shared))
        size = len(block.gradient)
        whole = np.block([[block.states, block.coupling], [block.coupling.T, block.shared]])
        whole[size:, size:] += np.diag(prior_terms(model.unknowns, shared)[1])
        return cls(problem, best, whole, coordinate_bounds(model.unknowns, shared), widening)

    def draw_steps(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw steps (count, M) from the best fit."""
        return self.widening * _sample_gaussian(self.information, count, rng)

    def move(self, step: FloatArray) -> tuple[Starts, FloatArray]:
        """Return start states and shared parameters at a step (M,) from the best fit."""
        unknowns, size = self.problem.model.unknowns, sum(len(start) for start in self.best.starts)
        middle, low, high = self.coordinates
        edges = np.cumsum([len(start) for start in self.best.starts])[:-1]
        parts = np.split(step[:size], edges)
        return (
            tuple(start + part for start, part in zip(self.best.starts, parts, strict=True)),
            values_from_coordinates(unknowns, np.clip(middle + step[size:], low, high)),
        )

    def sample(self, count: int, rng: np.random.Generator) -> list[tuple[Starts, FloatArray]]:
        """Draw start states and shared parameters, which are Gaussian in the search coordinates.

        Strongly nonlinear consequences, such as which ball is hit first, differ between samples.
        """
        return [self.move(step) for step in self.draw_steps(count, rng)]

    def log_ratio(self, step: FloatArray) -> float:
        """Return the logarithm of the true posterior over its Gaussian approximation at a step (M,); 0 at the best."""
        cost = simulate_chains(self.problem, *self.move(step)).cost - self.best.cost
        predicted = float(step @ self.information @ step)
        return -0.5 * (cost - predicted) / self.widening**2 if np.isfinite(cost) else -np.inf

    def sample_by_slices(self, count: int, rng: np.random.Generator) -> list[tuple[Starts, FloatArray]]:
        """Sample the true posterior by elliptical slice sampling (Murray, Adams, MacKay 2010, AISTATS).

        It needs no step size, and shrinks every step until it is as probable as a random level, so that a parameter
        without effect at the best fit but with a strong one elsewhere spreads no farther than the data allow.

        Args:
            count: Number of samples.
            rng: Random generator.

        Returns:
            Pairs of start states and shared parameters.
        """
        step, ratio, samples = np.zeros(len(self.information)), 0.0, []
        for direction in self.draw_steps(count + BURN_IN, rng):
            level = ratio - rng.exponential()
            angle = rng.uniform(0, 2 * np.pi)
            low, high = angle - 2 * np.pi, angle
            for _ in range(_MAX_SHRINKING):
                trial = step * np.cos(angle) + direction * np.sin(angle)
                ratio_there = self.log_ratio(trial)
                if ratio_there > level:
                    step, ratio = trial, ratio_there
                    break
                low, high = (angle, high) if angle < 0 else (low, angle)
                angle = rng.uniform(low, high)
            samples.append(self.move(step))
        return samples[BURN_IN:]


def _sample_gaussian(information: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw (count, M) Gaussian numbers with inverse covariance `information` (M, M), 0 along unobserved directions."""
    scale = np.sqrt(np.maximum(np.diag(information), MIN_INFORMATION))
    sizes, axes = np.linalg.eigh(information / scale / scale[:, None])
    spread = np.where(sizes > len(sizes) * np.finfo(float).eps, 1 / np.sqrt(np.maximum(sizes, 1e-300)), 0.0)
    samples: FloatArray = (rng.standard_normal((count, len(sizes))) * spread) @ axes.T / scale
    return samples
