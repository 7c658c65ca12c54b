"""The law of flight: against an independent integrator, and its derivatives against differences."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.physics.flight.flight_motion import find_descent, fly

TIMES = np.linspace(0.0, 1.5, 16)
SMASH = np.array([1, 2, 2.5, 60, -5, 3, 0.21, 0.006, -0.01, 0.004, 1.9, -0.06, 0.04])
SERVE = np.array([0, 4, 2.6, 50, 9, -4, 0.021, 0.002, 0.004, 0.001, 0.0, 0.03, 0.0])


def integrate(p, turn_length):
    """Integrate place, velocity and length of path with scipy."""

    def rate(_, y):
        v, speed = y[3:6], np.linalg.norm(y[3:6])
        fading = np.exp(-y[6] / turn_length) if turn_length else 0.0
        lift = (fading if turn_length else 1.0) * np.cross(p[7:10], v)
        u = 4 * y[6] / turn_length if turn_length else 0.0
        drag = p[6] * (1 + p[10] * u**2 * np.exp(-u) / 2) * (speed / 10) ** p[11]
        bending = np.array([0, 0, 9.81]) - 9.81 * v[2] * v / speed**2
        return [*v, *(speed * (lift - drag * v) - [0, 0, 9.81] + p[12] * bending), speed]

    path = solve_ivp(rate, (0, 1.5), [*p[:6], 0.0], "DOP853", TIMES, rtol=1e-12, atol=1e-12)
    return path.y[:6].T


@pytest.mark.parametrize(("p", "turn_length"), [(SMASH, 2.5), (SERVE, 0.0)])
def test_a_flight_agrees_with_an_independent_integrator(p, turn_length):
    assert np.abs(fly(p, TIMES, turn_length).states - integrate(p, turn_length)).max() < 1e-8
    assert np.abs(fly(p, TIMES, turn_length).states[:, :3] - integrate(p, turn_length)[:, :3]).max() < 3e-9


@pytest.mark.parametrize(("p", "turn_length"), [(SMASH, 2.5), (SERVE, 0.0)])
def test_derivatives_of_a_flight_agree_with_differences(p, turn_length):
    derivatives = fly(p, TIMES, turn_length).derivatives
    for k in range(len(p)):
        step = np.zeros(len(p))
        step[k] = 1e-5
        change = fly(p + step, TIMES, turn_length).states - fly(p - step, TIMES, turn_length).states
        scale = np.abs(derivatives[:, :, k]).max()
        assert np.abs(change / 2e-5 - derivatives[:, :, k]).max() < 1e-7 * max(scale, 1.0)


def test_a_flight_without_air_is_a_parabola_that_lands_on_time():
    p = np.array([0, 0, 2.0, 5, 1, 3, 0, 0, 0, 0, 0, 0, 0.0])
    states = fly(p, TIMES, 0.0).states
    assert np.allclose(states[:, 2], 2 + 3 * TIMES - 9.81 * TIMES**2 / 2, atol=1e-9)
    landing = (3 + np.sqrt(9 + 2 * 9.81 * 2)) / 9.81
    assert find_descent(p, 0.0, 0.0, 0.0, 3.0) == pytest.approx(landing, abs=1e-9)


@pytest.mark.parametrize(("p", "turn_length"), [(SMASH, 2.5), (SERVE, 0.0)])
def test_accelerations_are_those_of_the_velocities(p, turn_length):
    around = fly(p, np.array([0.2 - 1e-5, 0.2, 0.2 + 1e-5]), turn_length)
    change = (around.states[2, 3:] - around.states[0, 3:]) / 2e-5
    assert np.abs(around.accelerations[1] - change).max() < 1e-5 * np.abs(change).max()


def test_a_flight_may_be_followed_backwards():
    ahead = fly(SERVE, np.array([0.3]), 0.0).states[0]
    back = fly(np.append(ahead, SERVE[6:]), np.array([-0.3]), 0.0).states[0]
    assert np.allclose(back, SERVE[:6], atol=1e-7)


def test_a_shuttle_falls_at_its_terminal_speed():
    p = np.array([0, 0, 0, 0, 0, 0, 0.212, 0, 0, 0, 0, 0, 0.0])
    assert fly(p, np.array([6.0]), 0.0).states[0, 5] == pytest.approx(-np.sqrt(9.81 / 0.212), abs=1e-3)
