"""Selection of a method and its number of training steps by the error on held-out visible samples.

A network that is trained to zero loss fits the noise too. Every candidate, a method with a share of its steps, is
therefore first trained on a series with some visible samples held out. The candidate with the smallest error on them is
trained again on all visible samples. The samples on which methods are compared are not used.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    FittedMotion,
    MotionMethod,
    MotionNotFoundError,
    TrainingBudget,
    select_holdout,
    validate_samples,
)


@dataclass(frozen=True, slots=True)
class MethodSelection:
    """A method that selects the best of several candidates."""

    name: str
    candidates: tuple[tuple[MotionMethod, float], ...]
    """Methods, each with the share of its training steps."""

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Fit every candidate, and the best one again on all samples.

        If there are too few samples to hold any out, the first candidate is used. Arguments as in `MotionMethod.fit`.
        """
        began = time.process_time()
        t, x = validate_samples(times, states)
        whole = budget or TrainingBudget()
        scores = [
            evaluate_holdout_error(method, t, x, seed, split_budget(whole, effort, len(self.candidates)))
            for method, effort in self.candidates
        ]
        method, effort = self.candidates[int(np.argmin(scores))]
        fitted = method.fit(t, x, seed, split_budget(whole, effort, 1))
        return FittedMotion(fitted.motion, fitted.loss_curve, fitted.parameter_count, time.process_time() - began)


def split_budget(budget: TrainingBudget, effort: float, count: int) -> TrainingBudget:
    """Return the budget of one of `count` candidates, which together may take half the time."""
    return TrainingBudget(budget.effort * effort, budget.seconds / 2 / count)


def evaluate_holdout_error(
    method: MotionMethod, t: FloatArray, x: FloatArray, seed: int, budget: TrainingBudget
) -> float:
    """Evaluate the mean squared error on held-out samples; infinite if the method finds no motion."""
    is_held_out = select_holdout(len(t))
    if not is_held_out.any():
        return 0.0
    try:
        guess = method.fit(t[~is_held_out], x[~is_held_out], seed, budget).at(t[is_held_out])
    except MotionNotFoundError:
        return float("inf")
    error = float(np.mean((guess - x[is_held_out]) ** 2))
    return error if np.isfinite(error) else float("inf")
