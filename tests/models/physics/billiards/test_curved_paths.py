"""Paths under slope and drag, against an independent integrator and the mechanics of the slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.shot_inputs import differentiate_states

from models.core.typing import FloatArray
from models.physics.billiards.cloth.forces import evaluate_state_rate
from models.physics.billiards.cloth.motion_pieces import PIECE_END, ROLL, SLIDE
from models.physics.billiards.parameter_vector import parameter_index
from models.physics.billiards.simulation.simulate_shot import BallSet, SimulatedShot, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import TABLE_PRESETS

RADIUS, MU, GRAVITY = 0.03, 0.2, 9.81
CLOTH = {"sliding_friction": {"mu": MU}, "rolling_resistance": {"mu": 0.01}}
SLOPE = {"slope": {"slope_x": 3.0, "slope_y": -2.0}}
DRAG = {"air_drag": {"k": 0.03}, "viscous_drag": {"k": 0.05}}
STARTS = ([1.2, 0.3, 0.0, 0.0], [1.0, 0.5, -8.0, -20.0], [0.05, 0.02, 20.0, 9.0], [0.0, 0.0, 0.0, 30.0])
"""vx, vy (m/s), wx, wy (rad/s)."""


def roll_ball(start: list[float], more: dict[str, dict[str, float]], seconds: float) -> SimulatedShot:
    state = np.array([[1.2, 0.7, *start, 0.0]])
    balls = BallSet(("a",), state, np.array([RADIUS]), np.array([0.2]))
    return simulate(balls, TABLE_PRESETS["carom-match"], Physics.from_effects({**CLOTH, **more}), seconds)


def end_of_slide(run: SimulatedShot) -> float:
    pieces, _, phases, _ = run.collect_pieces()
    return float(pieces[phases == SLIDE, PIECE_END].max())


@pytest.mark.parametrize("more", [SLOPE, DRAG, {**SLOPE, **DRAG}])
@pytest.mark.parametrize("start", STARTS)
def test_a_slide_is_where_another_integrator_has_it(start: list[float], more: dict[str, dict[str, float]]) -> None:
    """Also between the ends of pieces, and in velocity and spin."""
    run = roll_ball(start, more, 1.0)
    until = 0.98 * end_of_slide(run)  # the very end has no direction that an integrator in time could follow

    def change(_: float, s: FloatArray) -> FloatArray:
        rate = np.zeros(6)
        evaluate_state_rate(s, RADIUS, run.physics.values, SLIDE, rate)
        return rate

    times = np.linspace(0, until, 97)
    reference = solve_ivp(change, (0, until), run.balls.state[0, :6], "DOP853", times, rtol=1e-13, atol=1e-14).y.T
    miss = np.abs(run.states_at(times)[:, 0, :6] - reference) * [1, 1, 1, 1, RADIUS, RADIUS]
    assert miss[:, :2].max() < 1e-8
    assert miss.max() < 1e-6


@pytest.mark.parametrize("start", STARTS)
def test_under_a_constant_pull_the_slip_ends_when_it_must(start: list[float]) -> None:
    """k |u| + b.u falls at the rate k^2 - b^2, with k = 7/2 mu g."""
    k, pull = 3.5 * MU * GRAVITY, GRAVITY * 1e-3 * np.array([3.0, -2.0])
    slip = np.array([start[0] - RADIUS * start[3], start[1] + RADIUS * start[2]])
    expected = (k * np.hypot(*slip) + pull @ slip) / (k**2 - pull @ pull)
    assert end_of_slide(roll_ball(start, SLOPE, 1.0)) == pytest.approx(expected, abs=2e-9)


@pytest.mark.parametrize("more", [SLOPE, DRAG])
def test_few_pieces_are_enough(more: dict[str, dict[str, float]]) -> None:
    """Integrating a slide by its slip alone took a hundred pieces."""
    assert len(roll_ball(STARTS[0], more, 2.0).collect_pieces()[0]) < 50


def test_derivatives_hold_where_an_effect_is_absent() -> None:
    """Differences of shots with a small slope and drag, and half of them, to remove the nonlinear part."""
    run = roll_ball(STARTS[1], {}, 1.0)
    times = np.linspace(0.05, 0.9, 11)
    for name, size in (("slope.slope_x", 0.05), ("air_drag.k", 0.002), ("viscous_drag.k", 0.002)):
        effect, parameter = name.split(".")
        small, large = (
            (roll_ball(STARTS[1], {effect: {parameter: part * size}}, 1.0).states_at(times) - run.states_at(times))
            / (part * size)
            for part in (0.5, 1.0)
        )
        exact = differentiate_states(run, times, (name,))[..., 0]
        np.testing.assert_allclose(exact[..., :2], (2 * small - large)[..., :2], rtol=3e-5, atol=1e-6)


def generic_rate(state: list[float], law: dict[str, float], phase: int = ROLL) -> FloatArray:
    """Return the time derivative (6,) of a state on a cloth with rolling resistance and this generic law."""
    p, rate = Physics.from_effects(CLOTH).values, np.zeros(6)
    for name, value in law.items():
        p[parameter_index(f"cloth_force.{name}")] = value
    evaluate_state_rate(np.array(state), RADIUS, p, phase, rate)
    return rate


@pytest.mark.parametrize("start", STARTS)
def test_the_generic_law_equals_the_named_forces_of_its_powers(start: list[float]) -> None:
    generic = {"brake_1": 0.05, "brake_2": 0.03, "pull_x": 3.0, "pull_y": -2.0}
    usual = roll_ball(start, {}, 1.0)
    values = usual.physics.values.copy()
    values[[parameter_index(f"cloth_force.{name}") for name in generic]] = list(generic.values())
    times = np.linspace(0, 1, 30)
    run = simulate(usual.balls, TABLE_PRESETS["carom-match"], replace(usual.physics, values=values), 1.0)
    expected = roll_ball(start, {**SLOPE, **DRAG}, 1.0).states_at(times)
    np.testing.assert_allclose(run.states_at(times), expected, atol=1e-9)
    assert not np.allclose(usual.states_at(times), expected, atol=1e-3)


def test_the_generic_law_turns_and_brakes_by_its_formula() -> None:
    """With 3 m/s along (0.6, 0.8): the left is (-0.8, 0.6)."""
    state, plain = [0.0, 0.0, 1.8, 2.4, -80.0, 60.0], generic_rate([0.0, 0.0, 1.8, 2.4, -80.0, 60.0], {})
    left = np.array([-0.8, 0.6])
    for law, expected in (
        ({"turn_1": 0.1}, 0.3 * left),
        ({"turn_0": 0.1}, 0.1 * 3.0 / np.hypot(3.0, 0.02) * left),
        ({"brake_3": 0.01}, -0.27 * np.array([0.6, 0.8])),
    ):
        np.testing.assert_allclose((generic_rate(state, law) - plain)[2:4], expected, atol=1e-12)


@pytest.mark.parametrize("phase", [ROLL, SLIDE])
def test_a_negative_generic_brake_drives_no_rolling_ball(phase: int) -> None:
    state = [0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / RADIUS + (5.0 if phase == SLIDE else 0.0)]
    rates = [generic_rate(state, {"brake_2": brake}, phase)[2] for brake in (-0.05, -1.0)]
    assert rates[0] < rates[1]
    assert generic_rate(state, {"brake_2": -2.0}, phase)[2] == rates[1], "the brake offsets rolling resistance at most"
    if phase == ROLL:
        assert rates[1] == pytest.approx(0.0, abs=1e-12)
