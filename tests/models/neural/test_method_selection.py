"""Selection of a method by held-out visible samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from support.pendulum_swings import circle, mse

from models.core.typing import FloatArray
from models.neural.common.method_interface import CUBIC, LINEAR, FittedMotion, MotionNotFoundError, TrainingBudget
from models.neural.common.network_training import TrainingSchedule
from models.neural.method_catalogue import MethodSelection
from models.neural.networks.neural_runge_kutta import SMOOTH_NET

TIMES = np.linspace(0, 1, 25)
MIDDLES = (TIMES[1:] + TIMES[:-1]) / 2


@dataclass(frozen=True)
class Nothing:
    """Finds no motion."""

    name: str = "nothing"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> FittedMotion:
        raise MotionNotFoundError("none")


CURVES = MethodSelection("curve", ((Nothing(), 1.0), (LINEAR, 1.0), (CUBIC, 1.0)))


def test_a_smooth_motion_gets_a_cubic_and_a_random_walk_lines() -> None:
    jagged = np.random.default_rng(0).standard_normal((25, 8, 2)).cumsum(axis=0)
    assert np.array_equal(CURVES.fit(TIMES, circle(TIMES)).at(MIDDLES), CUBIC.fit(TIMES, circle(TIMES)).at(MIDDLES))
    assert np.array_equal(CURVES.fit(TIMES, jagged).at(MIDDLES), LINEAR.fit(TIMES, jagged).at(MIDDLES))


def test_few_samples_get_the_first_candidate() -> None:
    few = TIMES[:4]
    first = MethodSelection("curve", ((LINEAR, 1.0), (CUBIC, 1.0)))
    assert np.array_equal(first.fit(few, circle(few)).at(few + 0.01), LINEAR.fit(few, circle(few)).at(few + 0.01))


def test_noise_stops_a_network_early_and_exact_samples_let_it_go_on() -> None:
    """Noise of 3 px on a circle of 100: the full training is the worse one there and the better one without it."""
    net = replace(
        SMOOTH_NET, widths=(24, 24), schedule=TrainingSchedule(adam_steps=60, learning_rate=3e-3, lbfgs_evaluations=200)
    )
    choice = MethodSelection("net", ((net, 0.25), (net, 1.0)))
    noisy = circle(TIMES) + 3 * np.random.default_rng(0).standard_normal((25, 1, 2))
    for samples, effort in ((noisy, 0.25), (circle(TIMES), 1.0)):
        fits = {share: net.fit(TIMES, samples, 0, TrainingBudget(share)) for share in (0.25, 1.0)}
        errors = {share: mse(fit.at(MIDDLES), circle(MIDDLES)) for share, fit in fits.items()}
        assert min(errors, key=lambda share: errors[share]) == effort
        assert np.array_equal(choice.fit(TIMES, samples).at(MIDDLES), fits[effort].at(MIDDLES))
