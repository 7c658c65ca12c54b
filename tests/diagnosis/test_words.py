"""What people read of a diagnosis are words, whatever the scene."""

from __future__ import annotations

import re

import numpy as np
import pytest

from diagnosis.fitting import names
from diagnosis.verdicts.localisation import OF_CAMERA
from models.estimation.gap_scenes.flight_scene import flight_scene
from models.estimation.gap_scenes.pendulum_scene import pendulum_scene
from models.estimation.gap_scenes.sliding_scene import slide_scene
from models.physics.effect import Effect
from models.physics.effects.catalogue import BILLIARDS, BILLIARDS_LAWS

SCENES = (flight_scene(3, 9.81, ()), pendulum_scene(2, ()), slide_scene(()))
EFFECTS: tuple[Effect, ...] = (*BILLIARDS, *(effect for scene in SCENES for effect in scene.effects))
GAUGES = ("frame_rate", "time_offset", "parallax_shift")


@pytest.mark.parametrize("name", sorted({*(one.name for one in (*EFFECTS, *BILLIARDS_LAWS)), *GAUGES}))
def test_every_cause_has_a_name_that_is_no_programmers(name: str) -> None:
    assert re.fullmatch(r"[a-z ]+", names.named(name))


@pytest.mark.parametrize("name", sorted({f"{one.name}.{p.name}" for one in EFFECTS for p in one.parameters}))
def test_every_parameter_is_told_with_its_effect(name: str) -> None:
    said = names.parameter(name)
    assert said.startswith(names.named(name.partition(".")[0]))
    assert not set("_.") & set(said)


def test_two_parameters_of_an_effect_are_never_told_by_one_word() -> None:
    for one in EFFECTS:
        assert len({names.parameter(p.name) for p in one.parameters}) == len(one.parameters)


def test_every_phase_is_in_the_table() -> None:
    phases = {phase for one in (*EFFECTS, *BILLIARDS_LAWS) for phase in one.phases} | OF_CAMERA
    assert phases <= set(names.PHASES)
    assert all("_" not in names.phase(name) for name in phases)


def test_groups_of_observations_are_places_and_times() -> None:
    assert names.group("since_contact", "0.1 to 0.2") == "0.1 to 0.2 s after a contact"
    assert names.group("phase", "free_roll") == "in free roll"
    assert names.group("all", "all") == "everywhere"
    assert names.direction(str(np.int64(1))) == "along the second axis"


def test_what_no_table_holds_is_still_legible() -> None:
    assert names.named("sticky_patch") == "sticky patch"
    assert names.phase("pocket_fall") == "in pocket fall"
