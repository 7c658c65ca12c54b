"""The neural Runge-Kutta simulator of Chen 2022 on motions that it can learn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from support.pendulum_swings import circle, mse
from torch import nn

from models.neural.common.method_interface import LINEAR, TrainingBudget
from models.neural.common.network_training import TrainingSchedule
from models.neural.networks.neural_runge_kutta import (
    CORRECTED_NET,
    EULER_NET,
    EXTRAPOLATION_NET,
    FOURIER_NET,
    PRINTED_NET,
    RUNGE_KUTTA_NET,
    SMOOTH_NET,
    NeuralSimulator,
)

TIMES = np.linspace(0, 1, 17)
MIDDLES = (TIMES[1:] + TIMES[:-1]) / 2
SMALL = {
    "widths": (24, 24), "activation": nn.Tanh, "dtype": torch.float64,
    "schedule": TrainingSchedule(adam_steps=150, lbfgs_evaluations=250),
}  # fmt: skip
ALL = (EULER_NET, RUNGE_KUTTA_NET, PRINTED_NET, CORRECTED_NET, EXTRAPOLATION_NET, SMOOTH_NET, FOURIER_NET)


def small(method: NeuralSimulator) -> NeuralSimulator:
    return replace(method, **SMALL)


@pytest.mark.parametrize(
    "method", [EULER_NET, RUNGE_KUTTA_NET, PRINTED_NET, CORRECTED_NET], ids=lambda method: method.name
)
def test_it_finds_midpoints_on_a_circle_far_better_than_lines(method: NeuralSimulator) -> None:
    """Over three seeds 7,000 to 43,000 times. Euler is no worse: its network learns mean velocities."""
    fitted = small(method).fit(TIMES, circle(TIMES))
    straight = mse(LINEAR.fit(TIMES, circle(TIMES)).at(MIDDLES), circle(MIDDLES))
    assert mse(fitted.at(MIDDLES), circle(MIDDLES)) < straight / 2000
    assert fitted.loss_curve.min() < 1e-3 * fitted.loss_curve[0]


def test_one_step_of_euler_is_the_straight_line_once_its_end_error_is_subtracted() -> None:
    """Chen 2022, section 2.3.1: Euler over a whole step is the average of the two."""
    fitted = replace(small(EXTRAPOLATION_NET), corrects_end_error=True).fit(TIMES, circle(TIMES))
    assert np.allclose(fitted.at(MIDDLES), LINEAR.fit(TIMES, circle(TIMES)).at(MIDDLES), atol=1e-9)


def test_extrapolation_goes_on_from_the_last_sample() -> None:
    fitted = small(EXTRAPOLATION_NET).fit(TIMES, circle(TIMES))
    soon = TIMES[-1] + np.array([1e-9, 1.0]) * TIMES[1]
    assert np.allclose(fitted.at(soon[:1]), circle(TIMES[-1:]), atol=1e-4)
    assert np.abs(fitted.at(soon[1:]) - circle(soon[1:])).max() < 10.0  # a chord is 39 px long


def test_a_corrected_motion_passes_through_every_sample() -> None:
    fitted = small(CORRECTED_NET).fit(TIMES, circle(TIMES), budget=TrainingBudget(effort=0.05))
    close = np.concatenate([TIMES[:-1], TIMES[1:] - 1e-9])
    assert np.abs(fitted.at(close) - circle(close)).max() < 1e-4


def test_uneven_samples_keep_their_times() -> None:
    uneven = np.sort(np.concatenate([TIMES[::2], TIMES[1:6:2]]))
    fitted = small(CORRECTED_NET).fit(uneven, circle(uneven))
    at = np.linspace(0, 1, 50)
    assert mse(fitted.at(at), circle(at)) < mse(LINEAR.fit(uneven, circle(uneven)).at(at), circle(at)) / 20


def test_equal_seeds_give_equal_bits_and_others_do_not() -> None:
    first, again, other = (
        replace(RUNGE_KUTTA_NET, widths=(64, 64)).fit(TIMES, circle(TIMES), seed, TrainingBudget(effort=0.01))
        for seed in (3, 3, 4)
    )
    assert np.array_equal(first.at(MIDDLES), again.at(MIDDLES))
    assert np.array_equal(first.loss_curve, again.loss_curve)
    assert not np.array_equal(first.at(MIDDLES), other.at(MIDDLES))


def test_coordinates_that_never_change_stay_where_they_are() -> None:
    states = np.concatenate([circle(TIMES), np.full((len(TIMES), 1, 2), 7.0)], axis=1)
    fitted = small(RUNGE_KUTTA_NET).fit(TIMES, states, budget=TrainingBudget(effort=0.05))
    assert np.allclose(fitted.at(MIDDLES)[:, 1], 7.0)


@pytest.mark.parametrize("method", ALL, ids=lambda method: method.name)
def test_every_simulator_reports_its_cost(method: NeuralSimulator) -> None:
    fitted = replace(method, widths=(8,)).fit(TIMES, circle(TIMES), budget=TrainingBudget(effort=0.01))
    assert fitted.parameter_count == (4 + (8 if method is FOURIER_NET else 0)) * 8 + 9 * 2  # 16 steps: four waves
    assert fitted.seconds > 0
    assert fitted.at(np.empty(0)).shape == (0, 1, 2)
    assert np.isfinite(fitted.at(np.linspace(-0.01, 1.2, 7))).all()
