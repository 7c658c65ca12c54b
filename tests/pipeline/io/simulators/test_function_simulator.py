"""A Python function as a simulator: many runs at once where it can, and the same motion where it cannot."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.estimation.gap_scenes.outside_simulator import Joint
from pipeline.io.simulators.function_simulator import FunctionSimulator, read_function, try_function

LAWS = """
import math
import numpy as np

calls = []

def by_arrays(state, inputs, dt):
    calls.append(np.shape(state))
    q, v = state
    v = v + dt * (inputs[0] - 20.0 * np.sin(q))
    return np.array([q + dt * v, v])

def by_numbers(state, inputs, dt):
    q, v = state
    v = v + dt * (inputs[0] - 20.0 * math.sin(q))
    return [q + dt * v, v]

def by_the_size_of_all(state, inputs, dt):
    q, v = state
    v = v + dt * (inputs[0] - 20.0 * q * np.linalg.norm(state))
    return np.array([q + dt * v, v])

def by_the_fastest(state, inputs, dt):
    q, v = state
    v = v + dt * (inputs[0] - 20.0 * np.sin(q) - np.where(np.max(np.abs(v)) > 1.0, v, 0.0))
    return np.array([q + dt * v, v])

def by_forces(state, inputs, dt, force):
    q, v = state
    v = v + dt * (inputs[0] - 20.0 * np.sin(q) + force[0] / 2.0)
    return np.array([q + dt * v, v])

def by_old_velocities(state, inputs, dt):
    q, v = state
    return np.array([q + dt * v, v + dt * (inputs[0] - 20.0 * np.sin(q))])

def that_states_it(state, inputs, dt):
    return by_arrays(state, inputs, dt)

that_states_it.velocity_lag = 0.0

def by_the_sum_of_all(state, inputs, dt):
    return by_arrays(state, inputs, dt) + 0.0 * np.sum(state)

def against_forces(state, inputs, dt, force):
    return by_forces(state, inputs, dt, -force)

def with_a_mass(state, inputs, dt, mass=1.0):
    return by_arrays(state, inputs / mass, dt)

for law in (by_arrays, by_numbers, by_the_size_of_all, by_the_fastest, by_forces, against_forces, with_a_mass,
            by_the_sum_of_all, by_old_velocities, that_states_it):
    law.inputs = ("push",)
"""
STATES = np.array([[0.1, 0.0], [0.2, 0.0], [-0.3, 0.0]])
STARTS = np.array([[0.1, 0.2], [0.9, -3.0], [0.4, 0.5], [-0.6, 2.0]])
INPUTS = np.random.default_rng(0).normal(size=(len(STARTS), 60, 1))
FORCE = np.random.default_rng(1).normal(size=(len(STARTS), 1))


@pytest.fixture
def laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "swing_laws.py").write_text(LAWS)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "swing_laws"


def play(simulator: FunctionSimulator, rows: slice = slice(None), starts: FloatArray = STARTS) -> FloatArray:
    own = starts[rows]
    runs = simulator.begin(own, [{}] * len(own), np.ones((len(own), 1), bool), np.zeros(len(own), int), np.zeros(1))
    return np.concatenate(
        [runs.advance(INPUTS[rows, :40], FORCE[rows]), runs.advance(INPUTS[rows, 40:], FORCE[rows])], axis=1
    )


@pytest.mark.parametrize(
    ("name", "takes_columns"),
    [
        ("by_arrays", True),
        ("by_numbers", False),
        ("by_the_size_of_all", False),
        ("by_the_fastest", True),
        ("by_forces", True),
    ],
)
def test_runs_side_by_side_move_as_each_does_alone(laws: str, name: str, takes_columns: bool):
    simulator = try_function(read_function(f"{laws}:{name}", (Joint("q", "rad"),)), STATES)
    assert simulator.takes_columns == pickle.loads(pickle.dumps(simulator)).takes_columns == takes_columns
    assert simulator.halve_step().takes_columns == takes_columns
    alone = np.concatenate([play(simulator, slice(k, k + 1)) for k in range(len(STARTS))])
    assert np.isfinite(alone).all()
    np.testing.assert_allclose(play(simulator), alone, rtol=1e-9, atol=1e-9)


def test_a_function_that_takes_forces_moves_as_they_and_its_inertia_say(laws: str):
    by_force = try_function(read_function(f"{laws}:by_forces", (Joint("q", "rad"),)), STATES)
    assert by_force.takes_forces
    assert pickle.loads(pickle.dumps(by_force)).joints[0].inertia == by_force.joints[0].inertia == pytest.approx(2.0)
    other = try_function(read_function(f"{laws}:with_a_mass", (Joint("q", "rad"),)), STATES)
    assert not other.takes_forces
    for runs in (slice(0, 1), slice(None)):
        inputs = INPUTS[runs] + FORCE[runs, None] / 2.0
        pushed = by_force.begin(STARTS[runs], [], np.zeros(0), np.zeros(0), np.zeros(0))
        driven = other.begin(STARTS[runs], [], np.zeros(0), np.zeros(0), np.zeros(0))
        np.testing.assert_allclose(
            pushed.advance(INPUTS[runs], FORCE[runs]), driven.advance(inputs, 0 * FORCE[runs]), rtol=1e-9, atol=1e-12
        )


@pytest.mark.parametrize(("name", "steps"), [("by_arrays", 0.5), ("by_old_velocities", 0.0), ("that_states_it", 0.0)])
def test_velocities_lag_where_positions_are_moved_by_the_new_ones(laws: str, name: str, steps: float):
    simulator = try_function(read_function(f"{laws}:{name}", (Joint("q", "rad"),)), STATES)
    assert simulator.velocity_lag == steps * simulator.time_step


def test_a_force_that_drives_backwards_is_one_sentence(laws: str):
    with pytest.raises(OptionError, match=r"a force of 1 on q adds an acceleration of -0\.5 to it; it has to be"):
        try_function(read_function(f"{laws}:against_forces", (Joint("q", "rad"),)), STATES)


def test_a_function_of_arrays_is_called_once_for_all_runs(laws: str):
    import swing_laws  # type: ignore[import-not-found]

    simulator = try_function(read_function(f"{laws}:by_arrays", (Joint("q", "rad"),)), STATES)
    swing_laws.calls.clear()
    play(simulator)
    together, alone = ([one for one in swing_laws.calls if len(one) == axes] for axes in (2, 1))
    assert together == [(2, len(STARTS))] * INPUTS.shape[1]
    assert len(alone) == pytest.approx(INPUTS.shape[1] / 8, abs=1), "now and then one is checked"


@pytest.mark.parametrize("name", ["by_arrays", "by_the_sum_of_all"])
def test_a_run_that_diverges_ends_alone(laws: str, name: str):
    simulator = try_function(read_function(f"{laws}:{name}", (Joint("q", "rad"),)), STATES)
    starts = STARTS.copy()
    starts[1] = np.inf
    path = play(simulator, starts=starts)
    assert np.isnan(path[1]).all()
    assert np.isfinite(np.delete(path, 1, axis=0)).all()
