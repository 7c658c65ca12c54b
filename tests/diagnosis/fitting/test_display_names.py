"""Reports of a diagnosis use words instead of identifiers, for every scene."""

from __future__ import annotations

import re

import numpy as np
import pytest

from diagnosis.fitting import display_names
from diagnosis.verdicts.gap_localisation import CAMERA_PHASES
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.pendulum_scene import build_pendulum_scene
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene
from models.physics.billiards.simulation.table_physics import BILLIARDS_MODEL_CHOICES
from models.physics.effect import Effect
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from models.physics.mechanisms.mechanism_effect import Scale

SCENES = (
    build_flight_scene(3, 9.81, ()),
    build_pendulum_scene(2, ()),
    build_sliding_scene((), ((0.0, 1.0), (0.0, 1.0))),
)
EFFECTS: tuple[Effect, ...] = (*BILLIARDS_EFFECTS, *(effect for scene in SCENES for effect in scene.effects))
SCENE_EFFECTS: dict[str, tuple[Effect, ...]] = {
    "billiards": BILLIARDS_EFFECTS,
    **{scene.name: scene.effects for scene in SCENES},
    "pendulum": build_pendulum_scene(1, ()).effects,
    "mechanism": tuple(one.for_mechanism({"joint": Scale("rad")}) for one in MECHANISM_EFFECTS.values()),
}
GAUGES = ("frame_rate", "time_offset", "parallax_shift")


@pytest.mark.parametrize("name", sorted({*(one.name for one in (*EFFECTS, *BILLIARDS_MODEL_CHOICES)), *GAUGES}))
def test_every_cause_has_a_name_that_is_no_programmers(name: str) -> None:
    assert re.fullmatch(r"[a-z ]+", display_names.format_cause(name))


@pytest.mark.parametrize("name", sorted({f"{one.name}.{p.name}" for one in EFFECTS for p in one.parameters}))
def test_every_parameter_is_told_with_its_effect(name: str) -> None:
    label = display_names.format_parameter(name)
    assert label.startswith(display_names.format_cause(name.partition(".")[0]))
    assert not set("_.") & set(label)


def test_a_strength_of_one_actuator_is_told_in_the_words_of_the_strength() -> None:
    assert display_names.format_parameter("actuator_gain.limit_left_hip") == "actuator gain, upper limit of left hip"
    assert display_names.format_parameter("actuator_gain.damping") == "actuator gain, servo damping"


def test_two_parameters_of_an_effect_are_never_told_by_one_word() -> None:
    for one in EFFECTS:
        assert len({display_names.format_parameter(p.name) for p in one.parameters}) == len(one.parameters)


def test_every_phase_is_in_the_table() -> None:
    phases = {phase for one in (*EFFECTS, *BILLIARDS_MODEL_CHOICES) for phase in one.phases} | CAMERA_PHASES
    assert phases <= set(display_names.PHASES)
    assert all("_" not in display_names.format_phase(name) for name in phases)


def test_groups_of_observations_are_places_and_times() -> None:
    assert display_names.format_group("since_contact", "0.1 to 0.2") == "0.1 to 0.2 s after a contact"
    assert display_names.format_group("phase", "free_roll") == "in free roll"
    assert display_names.format_group("all", "all") == "in all shots"
    assert display_names.format_group("speed", "1 to 2", "rad") == "at speeds of 1 to 2 rad/s"
    assert display_names.format_group("place", "(1, 2)", "rad") == "around (theta1, theta2) = (1, 2) rad"
    assert display_names.format_direction(str(np.int64(1)), ("x", "y")) == "a shift in y"


@pytest.mark.parametrize("scene", sorted(display_names.FORMULAS))
def test_formulas_are_of_effects_that_the_scene_has(scene: str) -> None:
    assert set(display_names.FORMULAS[scene]) <= {one.name for one in SCENE_EFFECTS[scene]}


def test_what_no_table_holds_is_still_legible() -> None:
    assert display_names.format_cause("sticky_patch") == "sticky patch"
    assert display_names.format_phase("pocket_fall") == "in pocket fall"
