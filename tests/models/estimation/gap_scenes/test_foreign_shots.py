"""Predictions of another engine are its own, and ours adds only what it does not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from support.simulated_shots import SIGMA, TABLE, opening

from models.core.recording import Recording
from models.core.scene import Table
from models.core.tracks import TABLE_PLANE
from models.core.typing import FloatArray
from models.estimation.gap_scenes.billiards_scene import BilliardsScene, build_billiards_scene, pair_with_simulator
from models.estimation.gap_scenes.gap_scene import neutral_values
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.parametrised_shot import (
    NEUTRAL_SHOT_PARAMETERS,
    SHOT_PARAMETERS,
    ContactModels,
)
from models.physics.billiards.simulation.simulate_shot import simulate
from models.physics.billiards.simulation.simulated_shot import BallSet
from models.physics.billiards.simulation.table_physics import Physics

STATED = {
    "rolling_resistance.mu": 0.013, "sliding_friction.mu": 0.22, "cushion_restitution.e": 0.8,
    "cushion_friction.mu": 0.2, "ball_restitution.e": 0.95, "ball_friction.mu": 0.05,
}  # fmt: skip
NOTHING, FORMS = NEUTRAL_SHOT_PARAMETERS, ("stronge", "alciatore")


class ShrinkingTable:
    """An engine that plays as ours, and states places a thousandth closer to the corner, so that it is another one."""

    name = "shrinking table"
    laws = ContactModels(*FORMS)
    stated: Mapping[str, float] = STATED
    nose_height = 1.3
    calls = 0
    fails = False

    def holds(self, laws: ContactModels) -> frozenset[str]:
        lacks = {"ball_friction.mu"} if laws.ball == "alciatore" else set[str]()
        return frozenset({*STATED, "cushion_height.ratio"} - lacks)

    def simulate(
        self, states: FloatArray, table: Table, values: Mapping[str, float], laws: ContactModels, t: FloatArray
    ) -> FloatArray | None:
        self.calls += 1
        if self.fails:
            return None
        numbers = NOTHING.copy()
        for name, value in values.items():
            numbers[SHOT_PARAMETERS.index(name)] = value
        count = len(states)
        balls = BallSet(tuple("abc"), states, np.full(count, table.ball_radius), np.full(count, table.ball_mass))
        physics = Physics(numbers[: len(PARAMETER_NAMES)], (), laws.cushion, laws.ball)
        return 0.999 * simulate(balls, table, physics, float(t[-1]) + 0.1).states_at(t)[..., :2]


def build_paired_scene() -> tuple[BilliardsScene, ShrinkingTable, Recording, FloatArray]:
    """A scene with another engine, a shot, and parameters as that engine states them."""
    start, _ = opening(np.random.default_rng(2))
    t = np.arange(60) / 60
    xy = np.repeat(start[None, :, :2], len(t), axis=0) + t[:, None, None] * start[:, 2:4]
    xy[:, :, 0] += SIGMA * np.sin(np.arange(60.0))[:, None]
    shot = Recording(0, np.arange(60), t, ("a", "b", "c"), xy, np.full(xy.shape[:2], SIGMA), TABLE_PLANE)
    engine = ShrinkingTable()
    scene = pair_with_simulator(build_billiards_scene(TABLE, (shot,)), engine)
    values = neutral_values(scene)
    for number, name in enumerate(list_names(scene)):
        if name.partition(".")[0] in scene.simulator_effects:
            values[number] = STATED[name]
    return scene, engine, shot, values


def list_names(scene: BilliardsScene) -> list[str]:
    return [f"{effect.name}.{one.name}" for effect in scene.effects for one in effect.parameters]


def test_the_scene_takes_effects_values_and_laws_from_the_engine() -> None:
    scene, _, _, _ = build_paired_scene()
    assert set(scene.simulator_effects) == {
        "rolling_resistance", "sliding_friction", "cushion_restitution", "cushion_friction", "ball_restitution",
    }  # fmt: skip
    assert tuple(one.simulator_form for one in scene.alternatives) == FORMS
    priors = {f"{effect.name}.{one.name}": one.value for effect in scene.effects for one in effect.parameters}
    assert {name: priors[name] for name in STATED} == STATED
    height = list_names(scene).index("cushion_height.ratio")
    assert neutral_values(scene)[height] == 1.3  # of its own table, whatever the law
    # a law without friction would be no rival of one that brings it
    assert scene.alternatives[1].companions == ("ball_friction",)


def test_a_prediction_without_further_effects_is_that_of_the_engine() -> None:
    scene, _, shot, values = build_paired_scene()
    model = scene.build_model((shot,), FORMS)
    start = model.windows[0].start
    path = scene.predict_positions(shot, start, values, FORMS)
    ours = replace(scene, simulator=None).build_model((shot,), FORMS).predict_observed_path(0, start, values)
    np.testing.assert_allclose(path, 0.999 * ours, atol=1e-9)
    residual = (path - shot.positions)[shot.is_observed] / SIGMA
    np.testing.assert_allclose(model.simulate(0, start, values).residual, residual, atol=1e-6)
    np.testing.assert_allclose(model.linearize(0, start, values).residual, residual, atol=1e-6)


def test_our_engine_adds_what_the_other_does_not_hold() -> None:
    scene, _, shot, values = build_paired_scene()
    start = scene.build_model((shot,), FORMS).windows[0].start
    flat = scene.predict_positions(shot, start, values, FORMS)
    ours = replace(scene, simulator=None)
    level = ours.predict_positions(shot, start, values, FORMS)
    values[list_names(scene).index("slope.slope_x")] = 4.0
    added = scene.predict_positions(shot, start, values, FORMS) - flat
    assert np.abs(added).max() > 1e-3
    np.testing.assert_allclose(added, ours.predict_positions(shot, start, values, FORMS) - level, atol=1e-9)


def test_small_steps_ask_the_engine_once_and_large_ones_again() -> None:
    scene, engine, shot, values = build_paired_scene()
    model = scene.build_model((shot,), FORMS)
    start = model.windows[0].start
    model.simulate(0, start, values)
    model.linearize(0, start, values)
    model.without_shared_jacobian().simulate(0, start + 1e-7, values)
    assert engine.calls == 1
    model.simulate(0, start * 1.1, values)
    assert engine.calls == 2


def test_a_shot_that_the_engine_cannot_play_costs_infinitely() -> None:
    scene, engine, shot, values = build_paired_scene()
    engine.fails = True
    model = scene.build_model((shot,), FORMS)
    start = model.windows[0].start
    assert np.isinf(model.simulate(0, start, values).residual).all()
    assert np.isinf(model.linearize(0, start, values).residual).all()
    assert np.isnan(scene.predict_positions(shot, start, values, FORMS)).all()


def test_a_stated_value_widens_bounds_that_it_would_break() -> None:
    engine = ShrinkingTable()
    engine.stated = STATED | {"rolling_resistance.mu": 0.08}
    scene = pair_with_simulator(build_paired_scene()[0], engine)
    rolling = next(one for one in scene.effects if one.name == "rolling_resistance").parameters[0]
    assert rolling.bounds == (0.001, 0.08)
