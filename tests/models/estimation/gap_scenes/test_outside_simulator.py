"""Motions of simulators from outside under effects: exact solutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.mechanism_inputs import EffectValues, InputHistory
from models.estimation.gap_scenes.outside_simulator import (
    Drive,
    Joint,
    Motions,
    Stretch,
    group_joints,
    simulate_motions,
)
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from models.physics.mechanisms.mechanism_effect import Scale

SCALES = (Scale("m", 1.0, 1.0),)


@dataclass
class FreeBody:
    """A body of 1 kg that its input pushes: exact for inputs that are constant during a step."""

    time_step: float = 0.001
    servo: int = -1
    joints: tuple[Joint, ...] = (Joint("x", "m"),)
    inputs: tuple[str, ...] = ("push",)
    takes_forces: bool = True
    is_free_beside_others: bool = False
    drives: tuple[Drive, ...] = ()
    last_mass: float = 1.0
    velocity_lag: float = 0.0
    rest: FloatArray = field(default_factory=lambda: np.zeros(2))
    own_effects: dict[str, tuple[float, ...]] = field(default_factory=dict)
    given: list[float] = field(default_factory=list)

    @property
    def servo_joints(self) -> tuple[int, ...]:
        return (self.servo,)

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shots: IntArray, t: FloatArray
    ) -> FreeRuns:
        assert not any(values)
        return FreeRuns(self, starts)


@dataclass
class FreeRuns:
    body: FreeBody
    states: FloatArray

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        path, h = [], self.body.time_step
        for k in range(inputs.shape[1]):
            self.body.given.append(float(inputs[0, k, 0]))
            a = inputs[:, k] + force
            x, v = np.split(self.states, 2, axis=1)
            self.states = np.concatenate([x + h * v + h * h / 2 * a, v + h * a], axis=1)
            path.append(self.states)
        return np.stack(path, axis=1)


def simulate_body(
    body: FreeBody, starts: FloatArray, values: Sequence[EffectValues], history: InputHistory, end: float
) -> Motions:
    stretch = Stretch(0, (0.0, end), history, starts, values)
    return simulate_motions(body, [stretch], SCALES * len(body.joints))[0]


def push_body(values: EffectValues, push: FloatArray, t: FloatArray, speed: float = 0.0) -> Motions:
    start, history = np.array([[0.0, speed]]), InputHistory(t, push[:, None])
    return simulate_body(FreeBody(), start, [values], history, t[-1])


def test_inputs_hold_from_row_to_row_and_delays_shift_them():
    t = np.arange(5) * 0.1
    history = InputHistory(t, np.array([[0.0], [1.0], [0.0], [2.0], [2.0]]))
    edges = np.arange(9) * 0.05
    np.testing.assert_allclose(history.average(edges, np.zeros(1))[:, 0], [0, 0, 1, 1, 0, 0, 2, 2], atol=1e-12)
    np.testing.assert_allclose(history.average(edges, np.array([0.1]))[2:, 0], [0, 0, 1, 1, 0, 0], atol=1e-12)
    half = history.average(edges, np.array([0.025]))[:, 0]
    np.testing.assert_allclose(half, [0, 0, 0.5, 1, 0.5, 0, 1, 2], atol=1e-12)


def test_an_empty_input_means_no_power():
    history = InputHistory(np.arange(3) * 0.1, np.array([[1.0], [np.nan], [np.nan]]))
    assert [history.is_powered(t)[0] for t in (0.0, 0.05, 0.1, 0.2)] == [True, True, False, False]


def test_a_delay_after_power_on_reaches_back_to_no_gap():
    history = InputHistory(np.arange(4) * 0.1, np.array([[np.nan], [1.0], [1.0], [2.0]]))
    assert history.is_powered(0.1)[0]
    delayed = history.average(np.array([0.1, 0.15, 0.2]), np.array([0.08]))
    np.testing.assert_allclose(delayed[:, 0], 1.0)


def test_states_between_steps_are_cubics():
    edges = np.array([0.0, 0.5, 1.0])
    states = np.stack([edges**3 - edges, 3 * edges**2 - 1], axis=1)[None]
    t = np.linspace(0, 1, 11)
    np.testing.assert_allclose(Motions(edges, states).at(t)[0], np.stack([t**3 - t, 3 * t**2 - 1], axis=1), atol=1e-12)


def test_dry_friction_stops_a_body_and_holds_it():
    t = np.linspace(0, 1.5, 31)
    values = {"joint_friction": (np.array([2.0]), np.array([0.0]))}
    x, v = push_body(values, np.zeros(31), t, 2.0).at(t)[0].T
    sliding = t < 0.95
    np.testing.assert_allclose(v[sliding], 2.0 - 2.0 * t[sliding], atol=1e-6)
    np.testing.assert_allclose(x[-1], 1.0, atol=0.01)
    assert np.abs(v[t > 1.05]).max() < 1e-6


def test_friction_that_exceeds_a_push_holds_a_body():
    t = np.linspace(0, 1.0, 21)
    values = {"joint_friction": (np.array([2.0]), np.array([0.0]))}
    x = push_body(values, np.full(21, 1.5), t).at(t)[0, :, 0]
    assert np.abs(x).max() < 1e-4  # without friction 0.75 m


def test_viscous_friction_and_air_drag_follow_their_laws():
    t = np.linspace(0, 1.0, 21)
    viscous = push_body({"joint_friction": (np.zeros(1), np.array([3.0]))}, np.zeros(21), t, 1.0).at(t)[0]
    np.testing.assert_allclose(viscous[:, 1], np.exp(-3.0 * t), rtol=1e-3)
    drag = push_body({"air_drag": (np.array([2.0]),)}, np.zeros(21), t, 1.0).at(t)[0]
    np.testing.assert_allclose(drag[:, 1], 1 / (1 + 2.0 * t), rtol=3e-3)


def test_a_generic_force_varies_over_the_reach_and_is_constant_beyond():
    """A half wave from 1 to -1 over the reach, which is 2 m here: F = -sin(pi x / 4)."""
    values = {"force_over_position": tuple(np.array([float(n == 1)]) for n in range(9))}
    t, start = np.linspace(0, 4.0, 41), np.array([[0.0, 2.5]])
    stretch = Stretch(0, (0.0, 4.0), InputHistory(t, np.zeros((41, 1))), start, [values])
    motions = simulate_motions(FreeBody(), [stretch], (replace(SCALES[0], reach=2.0),))[0]

    def fall(_: float, state: FloatArray) -> list[float]:
        return [state[1], -np.sin(np.pi / 4 * np.clip(state[0], -2.0, 2.0))]

    path = solve_ivp(fall, (0, 4.0), start[0], t_eval=t, rtol=1e-9, max_step=0.01).y
    assert path[0].max() > 2.5
    np.testing.assert_allclose(motions.at(t)[0, :, 0], path[0], atol=2e-3)


def test_brakes_of_a_driven_body_are_exact_to_second_order():
    t = np.linspace(0, 1.0, 101)
    values = {"joint_friction": (np.zeros(1), np.array([3.0]))}
    v = push_body(values, np.full(101, 2.0), t, 1.0).at(t)[0, :, 1]
    np.testing.assert_allclose(v, 2 / 3 + (1 - 2 / 3) * np.exp(-3.0 * t), atol=1e-3)


def test_a_lag_and_a_delay_change_a_push():
    t = np.linspace(0, 1.0, 101)
    push = (t >= 0.2).astype(float)
    lagged = push_body({"actuator_lag": (np.array([0.1]),)}, push, t).at(t)[0]
    after = np.maximum(t - 0.2, 0.0)
    np.testing.assert_allclose(lagged[:, 1], after - 0.1 * (1 - np.exp(-after / 0.1)), atol=2e-3)
    delayed = push_body({"delay": (np.array([0.15]),)}, push, t).at(t)[0]
    np.testing.assert_allclose(delayed[:, 1], np.maximum(t - 0.35, 0.0), atol=1e-6)


def test_a_gain_a_limit_a_dead_band_and_play_change_what_an_actuator_does():
    t = np.linspace(0, 1.0, 101)
    wave = np.sin(2 * np.pi * t)
    speed = {
        name: push_body({name: (np.array([value]),)}, wave, t).at(t)[0, :, 1]
        for name, value in (("actuator_gain", 0.5), ("saturation", 0.5), ("dead_band", 0.5))
    }
    plain = push_body({}, wave, t).at(t)[0, :, 1]
    np.testing.assert_allclose(speed["actuator_gain"], plain / 2, atol=1e-9)
    step = np.diff(t, prepend=0.0)
    held = np.concatenate([[0.0], wave[:-1]])
    np.testing.assert_allclose(speed["saturation"], np.cumsum(np.clip(held, -0.5, 0.5) * step), atol=2e-3)
    beyond = np.sign(held) * np.maximum(np.abs(held) - 0.5, 0)
    np.testing.assert_allclose(speed["dead_band"], np.cumsum(beyond * step), atol=2e-3)
    played = push_body({"backlash": (np.array([0.4]),)}, np.array([0.0] * 20 + [1.0] * 40 + [0.7] * 41), t).at(t)[0]
    # one way the play takes half of its width; back by 0.3, less than the width, nothing changes
    np.testing.assert_allclose(played[-1, 1], 0.8 * 0.8, atol=1e-3)


def test_a_servo_has_a_dead_band_about_its_place():
    body = FreeBody(servo=0)
    t = np.linspace(0, 0.1, 11)
    values: EffectValues = {"dead_band": (np.array([0.3]),)}
    history = InputHistory(t, np.full((11, 1), 0.2))
    simulate_body(body, np.array([[0.0, 0.0]]), [values], history, 0.1)
    assert max(body.given) == pytest.approx(0.0)  # asked for its own place
    history = InputHistory(t, np.full((11, 1), 0.5))
    simulate_body(body, np.array([[0.0, 0.0]]), [values], history, 0.1)
    assert body.given[-1] == pytest.approx(0.2, abs=2e-3)


def test_runs_side_by_side_are_the_runs_alone():
    t = np.linspace(0, 0.5, 11)
    history = InputHistory(t, np.sin(10 * t)[:, None])
    starts = np.array([[0.0, 1.0], [0.1, -2.0], [0.0, 0.0]])
    values: list[EffectValues] = [{}, {"air_drag": (np.array([2.0]),)}, {"stribeck": (np.ones(1), np.array([0.1]))}]
    together = simulate_body(FreeBody(), starts, values, history, 0.5).states
    for start, own, path in zip(starts, values, together, strict=True):
        alone = simulate_body(FreeBody(), start[None], [own], history, 0.5).states[0]
        np.testing.assert_allclose(path, alone, atol=1e-12)


def test_stretches_side_by_side_are_the_stretches_alone():
    """Whatever their times, inputs and lengths are; those of unlike lengths are simulated apart."""
    t = np.linspace(0, 0.5, 11)
    drag: EffectValues = {"air_drag": (np.array([2.0]),)}
    stretches = [
        Stretch(shot, span, InputHistory(t, np.sin(rate * t)[:, None]), np.array([[0.0, 1.0], [0.1, -2.0]]), [{}, drag])
        for shot, (span, rate) in enumerate([((0.0, 0.1), 9.0), ((0.05, 0.5), 5.0), ((0.12, 0.21), 3.0)])
    ]
    for one, both in zip(stretches, simulate_motions(FreeBody(), stretches, SCALES), strict=True):
        alone = simulate_motions(FreeBody(), [one], SCALES)[0]
        np.testing.assert_array_equal(both.edges, alone.edges)
        np.testing.assert_allclose(both.states, alone.states, atol=1e-12)


@pytest.mark.parametrize("name", sorted(MECHANISM_EFFECTS))
def test_every_effect_has_parameters_for_every_joint(name: str):
    scales = {"shoulder": Scale("rad", 0.5, 2.0, 1.0, 0.1, True), "elbow": Scale("rad", 0.5, 2.0, 1.0, 0.1, True)}
    effect = MECHANISM_EFFECTS[name].for_mechanism(scales)
    count = len(MECHANISM_EFFECTS[name].list_strengths(False))
    assert len(effect.parameters) == count * (1 if MECHANISM_EFFECTS[name].site == "mechanism" else 2)
    assert all(one.bounds[0] <= one.value <= one.bounds[1] and one.sigma > 0 for one in effect.parameters)
    assert effect.reference


def test_drag_of_a_free_body_acts_against_its_velocity():
    """k |v| v with one k: along each axis alone, it would be k v_x |v_x|."""
    body = FreeBody(joints=tuple(Joint(f"ball.{axis}", "m", body="ball") for axis in "xy"))
    body.rest = np.zeros(4)
    t = np.linspace(0, 2, 5)
    start, k = np.array([[0.0, 0.0, 3.0, 4.0]]), 0.2
    drag = {"air_drag": (np.full(2, k),)}
    motions = simulate_body(body, start, [drag], InputHistory(t, np.zeros((5, 1))), 2.0)
    path = np.log1p(5.0 * k * t) / k
    np.testing.assert_allclose(motions.at(t)[0, :, :2], path[:, None] * [0.6, 0.8], rtol=2e-5)


def test_a_joint_that_is_called_like_a_free_body_is_a_group_of_its_own() -> None:
    free = [Joint(f"ball.{axis}", "m", body="ball") for axis in "xyz"]
    names, groups = group_joints([*free, Joint("ball", "rad"), Joint("hinge", "rad")])
    assert names == ("ball", "ball_joint", "hinge")
    assert groups.tolist() == [0, 0, 0, 1, 2]
