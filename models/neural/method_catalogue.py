"""Catalogue of all methods that learn a motion, in the order of tables, and the selection of one by held-out samples.

A network that is trained to zero loss fits the noise too. Every candidate, a method with a share of its steps, is
therefore first trained on a series with some visible samples held out. The candidate with the smallest error on them is
trained again on all visible samples. The samples on which methods are compared are not used.

The module imports torch, which takes seconds; import it inside the function that needs it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    CURVES,
    FittedMotion,
    MotionMethod,
    MotionNotFoundError,
    TrainingBudget,
    select_holdout,
    validate_samples,
)
from models.neural.networks.constraint_net import CONSTRAINT_NET
from models.neural.networks.hamiltonian_network import HAMILTONIAN, SEPARABLE
from models.neural.networks.interaction_network import INTERACTION
from models.neural.networks.neural_flow import PLAIN_FLOW, SECOND_ORDER
from models.neural.networks.neural_runge_kutta import (
    CORRECTED_NET,
    EULER_NET,
    EXTRAPOLATION_NET,
    FOURIER_NET,
    PRINTED_NET,
    RUNGE_KUTTA_NET,
    SMOOTH_NET,
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


# Networks of Chen 2022, with three layers of 512.
THESIS_METHODS: tuple[MotionMethod, ...] = (EULER_NET, RUNGE_KUTTA_NET, PRINTED_NET, CORRECTED_NET, EXTRAPOLATION_NET)
SELECTED_NETWORK = MethodSelection(
    "chosen net",
    tuple((method, effort) for method in (SMOOTH_NET, SECOND_ORDER, HAMILTONIAN) for effort in (1.0, 0.2, 0.05)),
)
EXTENSIONS: tuple[MotionMethod, ...] = (SMOOTH_NET, FOURIER_NET, SECOND_ORDER, SELECTED_NETWORK)
COMPETING_METHODS: tuple[MotionMethod, ...] = (PLAIN_FLOW, HAMILTONIAN, SEPARABLE, INTERACTION, CONSTRAINT_NET)
NETWORKS: tuple[MotionMethod, ...] = (*THESIS_METHODS, *EXTENSIONS, *COMPETING_METHODS)
METHODS: tuple[MotionMethod, ...] = (*CURVES, *NETWORKS)
