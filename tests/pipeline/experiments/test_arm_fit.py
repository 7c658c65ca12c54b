"""The fit of two arms against another integrator and true parameters, and the energy of the arms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from models.core.typing import FloatArray
from models.estimation.gap_scenes.pendulum_scene import pendulum_effects, two_rod_acceleration
from pipeline.experiments.thesis.arm_fit import fit_arms

PRIORS = [prior for effect in pendulum_effects(2) for prior in effect.parameters]
# pull, second, coupling, second_pull
RODS = [60.0, 0.5, 0.45, 28.0]
FRICTIONLESS = np.array([*RODS, *np.zeros(len(PRIORS) - 4)])
WILD = np.array([2.0, 2.6, 1.0, -0.5])
EVERY = 0.13
"""s between samples: cubic splines fail there."""


def integrate_arms(parameters: FloatArray, t: FloatArray) -> FloatArray:
    """Integrate states (T, 4) by scipy."""

    def evaluate_rate(_: float, state: FloatArray) -> FloatArray:
        rate = np.empty(2)
        two_rod_acceleration(state[:2], state[2:], parameters, np.zeros(3), rate)
        return np.concatenate([state[2:], rate])

    return np.asarray(solve_ivp(evaluate_rate, (0, t[-1]), WILD, "DOP853", t, rtol=1e-10, atol=1e-10).y.T)


def measure_energy(states: FloatArray) -> FloatArray:
    """Return the energies (T,) of states (T, 4) over the inertia of the first arm, 1/s^2."""
    pull, second, coupling, second_pull = RODS
    one, two, w1, w2 = states.T
    moving = 0.5 * w1**2 + 0.5 * second * w2**2 + coupling * w1 * w2 * np.cos(one - two)
    return np.asarray(moving - pull * np.cos(one) - second_pull * np.cos(two))


def test_arms_without_friction_conserve_energy() -> None:
    assert np.ptp(measure_energy(integrate_arms(FRICTIONLESS, np.linspace(0, 5, 51)))) < 1e-6 * RODS[0]


@pytest.mark.parametrize("name", ["viscous", "dry", "viscous_2", "dry_2"])
def test_friction_of_every_kind_dissipates_energy(name: str) -> None:
    parameters = FRICTIONLESS.copy()
    parameters[[prior.name for prior in PRIORS].index(name)] = 0.2
    assert np.all(np.diff(measure_energy(integrate_arms(parameters, np.linspace(0, 3, 31)))) < 1e-6)


def test_the_motion_between_few_angles_is_recovered() -> None:
    t = np.arange(0, 2.6, EVERY / 2)
    parameters = FRICTIONLESS.copy()
    parameters[4], parameters[6] = 0.04, 0.01
    states = integrate_arms(parameters, t)
    observed = states[::2, :2] + 1e-3 * np.random.default_rng(0).standard_normal((len(t[::2]), 2))
    motion, fitted = fit_arms(t[::2], observed)
    between = slice(1, len(t) - 1, 2)
    off = np.mean((motion(t[between]) - states[between, :2]) ** 2)
    assert off < np.mean((CubicSpline(t[::2], observed)(t[between]) - states[between, :2]) ** 2) / 50
    assert [prior.name for prior in fitted][:4] == ["pull", "second", "coupling", "second_pull"]
