"""The double pendulum: conservation, another integrator, finite differences; its fit against true parameters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from models.core.typing import FloatArray
from models.estimation.springs.double_pendulum import (
    PENDULUM_PARAMETERS,
    advance_pendulum,
    differentiate_pendulum,
    fill_pendulum_rate,
    fit_pendulum,
)

ARMS = np.array([0.45, 0.5, 60.0, 28.0, 0.04, 0.01, 0.0, 0.0, 0.002, 0.002])
SMOOTH = np.concatenate([ARMS[:4], np.zeros(6)])
WILD = np.array([2.0, 2.6, 1.0, -0.5])
EVERY = 0.13
"""s between samples: cubic splines fail there."""


def integrate_pendulum(numbers: FloatArray, t: FloatArray) -> FloatArray:
    """Integrate states (T, 4) by scipy."""

    def evaluate_rate(_: float, state: FloatArray) -> FloatArray:
        rate = np.empty(4)
        fill_pendulum_rate(state, numbers, rate)
        return rate

    path = solve_ivp(evaluate_rate, (0, t[-1]), WILD, "DOP853", t, rtol=1e-10, atol=1e-10)
    return np.asarray(path.y.T)


def pendulum_energy(state: FloatArray, numbers: FloatArray) -> FloatArray:
    """Return the energies (T,) over A, 1/s^2, of states (4, T)."""
    first, second, w1, w2 = state
    coupling, inertia, weight1, weight2 = numbers[:4]
    moving = 0.5 * w1**2 + 0.5 * inertia * w2**2 + coupling * w1 * w2 * np.cos(first - second)
    return np.asarray(moving - weight1 * np.cos(first) - weight2 * np.cos(second), np.float64)


def test_arms_without_friction_conserve_energy() -> None:
    states = integrate_pendulum(SMOOTH, np.linspace(0, 5, 51))
    assert np.ptp(pendulum_energy(states.T, SMOOTH)) < 1e-6 * SMOOTH[2]


def test_friction_of_every_kind_dissipates_energy() -> None:
    for k in range(4, len(PENDULUM_PARAMETERS)):
        numbers = SMOOTH.copy()
        numbers[k] = 0.2
        states = integrate_pendulum(numbers, np.linspace(0, 3, 31))
        assert np.all(np.diff(pendulum_energy(states.T, numbers)) < 1e-6), PENDULUM_PARAMETERS[k]


def test_steps_agree_with_another_integrator() -> None:
    t = np.linspace(0, 1.3, 11)
    states = integrate_pendulum(ARMS, t)
    ends = advance_pendulum(states[:-1], np.tile(ARMS, (10, 1)), np.diff(t))
    assert np.allclose(ends, states[1:], atol=1e-5)


def test_derivatives_equal_finite_differences() -> None:
    numbers = np.where(ARMS == 0, 0.05, ARMS)
    span = np.array([EVERY])
    _, by_start, by_numbers = differentiate_pendulum(WILD[None], numbers, span)
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        ends = [differentiate_pendulum((WILD + sign * step)[None], numbers, span)[0][0] for sign in (1, -1)]
        assert np.allclose(by_start[0, :, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-4, atol=1e-5)
    for k in range(len(PENDULUM_PARAMETERS)):
        step = 1e-6 * np.eye(len(PENDULUM_PARAMETERS))[k]
        ends = [differentiate_pendulum(WILD[None], numbers + sign * step, span)[0][0] for sign in (1, -1)]
        assert np.allclose(by_numbers[0, :, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-4, atol=1e-5)


def test_parameters_are_recovered_from_few_angles() -> None:
    t = np.arange(0, 2.6, EVERY / 2)
    states = integrate_pendulum(ARMS, t)
    observed = states[::2, :2] + 1e-3 * np.random.default_rng(0).standard_normal((len(t[::2]), 2))
    fit = fit_pendulum(t[::2], observed)
    between = slice(1, len(t) - 1, 2)
    off = np.mean((fit.states_at(t[between])[:, :2] - states[between, :2]) ** 2)
    spline = np.mean((CubicSpline(t[::2], observed)(t[between]) - states[between, :2]) ** 2)
    assert off < spline / 50
    assert np.allclose(fit.parameters[:4], ARMS[:4], rtol=0.02)


def test_few_samples_are_an_error() -> None:
    with pytest.raises(ValueError, match="8 samples"):
        fit_pendulum(np.arange(5.0), np.zeros((5, 2)))
