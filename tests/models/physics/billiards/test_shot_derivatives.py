"""Exact derivatives of a shot against differences of whole shots, for all models and effects."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from support.shot_inputs import differentiate_states, list_inputs

from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.contact_models import BALL_MODELS, CUSHION_MODELS
from models.physics.billiards.parameter_vector import (
    PARAMETER_NAMES,
    PATH_BENDING_PARAMETERS,
    TABLE_PARAMETERS,
    parameter_index,
)
from models.physics.billiards.simulation.simulate_shot import BallSet, SimulatedShot, simulate
from models.physics.billiards.simulation.table_physics import Physics, contact_parameters
from models.physics.billiards.tables import TABLE_PRESETS

CAROM = TABLE_PRESETS["carom-match"]
TIMES = np.array([0.0, 0.2, 0.55, 1.2, 1.6, 2.35])
UNITS = np.array([1.0, 1.0, 1.0, 1.0, 0.03, 0.03, 0.03])
"""Turn a state into m and m/s."""
USUAL = {
    "sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.01}, "spin_decay": {"rate": 10.0},
    "cushion_restitution": {"e": 0.85}, "cushion_restitution_speed": {"slope": 0.02}, "cushion_friction": {"mu": 0.2},
    "ball_restitution": {"e": 0.95}, "ball_friction": {"mu": 0.05},
}  # fmt: skip
GENERIC = {
    "cloth_force.brake_1": 0.03, "cloth_force.brake_2": -0.01, "cloth_force.brake_3": 0.01,
    "cloth_force.turn_0": 0.02, "cloth_force.turn_1": -0.03, "cloth_force.pull_x": 1.0, "cloth_force.pull_y": -2.0,
    "cushion_rebound.e_0": -0.02, "cushion_rebound.e_1": 0.01, "cushion_rebound.e_2": -0.03,
    "cushion_rebound.grip_0": 0.02, "cushion_rebound.grip_1": 0.01, "cushion_rebound.roll": 0.05,
    "ball_impulse.e_0": -0.02, "ball_impulse.e_1": 0.01, "ball_impulse.grip_0": 0.02, "ball_impulse.grip_1": 0.01,
}  # fmt: skip
CURVING = {"slope": {"slope_x": 2.0, "slope_y": -1.0}, "air_drag": {"k": 0.05}, "viscous_drag": {"k": 0.05}}


def physics(cushion: str, ball: str, more: dict[str, dict[str, float]]) -> Physics:
    used = {*contact_parameters(cushion, ball), "sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate"}
    chosen = {e: v for e, v in USUAL.items() if all(f"{e}.{name}" in used for name in v)}
    return Physics.from_effects({**chosen, **more}, cushion, ball)


def shot(table: Table = CAROM) -> FloatArray:
    """x, y, vx, vy, wx, wy, wz, radius, mass (3, 9) of three unequal balls that all move and meet each other."""
    return np.array(
        [
            [0.5, 0.5, 3.0, 0.7, 3.0, 40.0, 11.3, 0.0300, 0.20],
            [1.5, 0.70, 0.15, 0.05, -1.0, 4.0, 2.3, 0.0310, 0.21],
            [2.3, 1.0, -0.3, 0.1, 0.0, 0.0, 5.7, 0.0305, 0.22],
        ]
    )


def simulate_inputs(inputs: FloatArray, physics: Physics, table: Table) -> SimulatedShot:
    """Simulate the shot of all inputs (P,), in the order of `list_inputs`."""
    balls = inputs[:27].reshape(3, 9)
    ball_set = BallSet(("a", "b", "c"), balls[:, :7].copy(), balls[:, 7].copy(), balls[:, 8].copy())
    values = inputs[27 : 27 + len(PARAMETER_NAMES)]
    return simulate(ball_set, table, replace(physics, values=values), 3.0, inputs[27 + len(PARAMETER_NAMES) :])


def differences(
    inputs: FloatArray, column: int, step: float, physics: Physics, table: Table, order: FloatArray
) -> FloatArray:
    """Compute central differences of the fourth order (T, N, 7)."""
    estimates = []
    for h in (step, step / 2):
        ends = []
        for sign in (1.0, -1.0):
            moved = inputs.copy()
            moved[column] += sign * h
            run = simulate_inputs(moved, physics, table)
            np.testing.assert_array_equal(run.contacts[:, [0, 2, 3]], order)
            ends.append(run.states_at(TIMES))
        estimates.append((ends[0] - ends[1]) / (2 * h))
    return (4 * estimates[1] - estimates[0]) / 3


def check(physics: Physics, table: Table, step: float, within: float, least: int) -> None:
    inputs = np.concatenate([shot().ravel(), physics.values, np.zeros(4)])
    run = simulate_inputs(inputs, physics, table)
    assert len(run.contacts) >= least
    curved = {PARAMETER_NAMES[k] for k in PATH_BENDING_PARAMETERS}
    if physics.ball == "elastic":  # without a loss of energy, the restitution can only fall
        curved |= {name for name in GENERIC if name.startswith("ball_impulse")}
    wrt = tuple(name for name in list_inputs(run) if name not in curved or name in physics.present)
    exact = differentiate_states(run, TIMES, wrt)
    assert exact.shape == (len(TIMES), 3, 7, len(wrt))
    for k, name in enumerate(wrt):
        one = {"w": 30.0, "k": 0.1}.get(name.split(".")[1][0], 1.0) * (0.01 if name.startswith("nap") else 1.0)
        column = list_inputs(run).index(name)
        numeric = differences(inputs, column, step * one, physics, table, run.contacts[:, [0, 2, 3]])
        size = max(np.abs(exact[..., k] * UNITS).max(), 1e-3)
        assert np.abs((numeric - exact[..., k]) * UNITS).max() < within * size, name


@pytest.mark.parametrize(
    ("cushion", "ball"), [*product(CUSHION_MODELS, ["inelastic"]), *product(["mirror"], BALL_MODELS)]
)
def test_derivatives_match_differences_for_every_law(cushion: str, ball: str) -> None:
    check(physics(cushion, ball, {}), CAROM, 1e-6, 2e-6, 4)


def test_derivatives_match_differences_for_every_effect() -> None:
    """An integrated path has an error of 1e-10 m, so the steps have to be large and the differences are worse."""
    check(physics("mirror", "inelastic", {**CURVING, "nap": {"mu": 0.002}}), CAROM, 3e-4, 1e-4, 3)


def test_derivatives_match_differences_for_generic_laws() -> None:
    assert set(GENERIC) == set(PARAMETER_NAMES) - set(TABLE_PARAMETERS)
    usual = physics("han_2005", "alciatore", {})
    values = usual.values.copy()
    values[[parameter_index(name) for name in GENERIC]] = list(GENERIC.values())
    check(replace(usual, values=values, present=(*usual.present, *GENERIC)), CAROM, 3e-4, 1e-4, 3)


def test_an_absent_effect_has_a_derivative_too() -> None:
    flat = physics("mirror", "inelastic", {})
    inputs = np.concatenate([shot().ravel(), flat.values, np.zeros(4)])
    run = simulate_inputs(inputs, flat, CAROM)
    for name, step in (
        ("slope.slope_x", 1e-3),
        ("slope.slope_y", 1e-3),
        ("air_drag.k", 1e-5),
        ("viscous_drag.k", 1e-5),
        *((f"cloth_force.{name}", 1e-5) for name in ("brake_1", "brake_2", "brake_3", "turn_1")),
        *((f"cloth_force.{name}", 1e-3) for name in ("turn_0", "pull_x", "pull_y")),
    ):
        exact = differentiate_states(run, TIMES, (name,))[..., 0]
        column = list_inputs(run).index(name)
        numeric = np.zeros_like(exact)
        for h, weight in ((step, 2.0), (2 * step, -0.5), (0.0, -1.5)):  # one-sided: drag does not go below 0
            moved = inputs.copy()
            moved[column] += h
            numeric += weight * simulate_inputs(moved, flat, CAROM).states_at(TIMES) / step
        assert np.abs((numeric - exact) * UNITS).max() < 1e-3 * np.abs(exact * UNITS).max(), name


def test_a_ball_in_a_pocket_has_no_state_and_no_derivative() -> None:
    table = TABLE_PRESETS["pool-9ft"]
    way = np.array([1.0, 0.5]) / np.hypot(1.0, 0.5)
    state = np.array([[1.27, 0.635, *(2 * way), 0, 0, 0]])
    run = simulate(BallSet(("cue",), state, np.array([0.0286]), np.array([0.17])), table, Physics.from_effects({}), 3.0)
    assert run.events.kind[-1] == "pocket"
    assert np.all(np.isnan(run.states_at(3.0)))
    assert np.all(np.isnan(differentiate_states(run, 3.0)))
    assert np.all(np.isfinite(differentiate_states(run, 0.1)))


def test_a_direction_adds_up_the_columns_that_it_moves() -> None:
    usual = physics("mathavan_2010", "inelastic", {})
    run = simulate_inputs(np.concatenate([shot().ravel(), usual.values, np.zeros(4)]), usual, CAROM)
    columns = tuple(
        name for name in list_inputs(run) if name.split(".")[0] not in ("slope", "air_drag", "viscous_drag")
    )
    directions = np.zeros((len(list_inputs(run)), 3))
    mixed = np.random.default_rng(1).normal(size=(len(columns), 3))
    directions[[list_inputs(run).index(name) for name in columns]] = mixed
    place = np.full((len(TIMES), 3), -1)
    place[::2, 1], place[1::2, 2] = np.arange(3), 3 + np.arange(3)
    times, balls = np.nonzero(place.T >= 0)[::-1]
    expected = differentiate_states(run, TIMES, columns)[times, balls] @ mixed
    for numbers in (2, 7):
        derivatives = run.directional_derivatives(TIMES, place, directions, numbers)
        np.testing.assert_allclose(derivatives[place[times, balls]], expected[:, :numbers], rtol=1e-9, atol=1e-9)
