"""What people read of a diagnosis are words, whatever the scene."""

from __future__ import annotations

import re

import numpy as np
import pytest

from diagnosis import words
from diagnosis.where import OF_CAMERA
from models.effects.catalogue import BILLIARDS, BILLIARDS_LAWS
from models.effects.effect import Effect
from models.flight.gap import flight_scene
from models.pendulum.gap import pendulum_scene
from models.slide.gap import slide_scene

SCENES = (flight_scene(3, 9.81, ()), pendulum_scene(2, ()), slide_scene(()))
EFFECTS: tuple[Effect, ...] = (*BILLIARDS, *(effect for scene in SCENES for effect in scene.effects))
GAUGES = ("frame_rate", "time_offset", "parallax_shift")


@pytest.mark.parametrize("name", sorted({*(one.name for one in (*EFFECTS, *BILLIARDS_LAWS)), *GAUGES}))
def test_every_cause_has_a_name_that_is_no_programmers(name: str) -> None:
    assert re.fullmatch(r"[a-z ]+", words.named(name))


@pytest.mark.parametrize("name", sorted({f"{one.name}.{p.name}" for one in EFFECTS for p in one.parameters}))
def test_every_parameter_is_told_with_its_effect(name: str) -> None:
    said = words.parameter(name)
    assert said.startswith(words.named(name.partition(".")[0]))
    assert not set("_.") & set(said)


def test_two_parameters_of_an_effect_are_never_told_by_one_word() -> None:
    for one in EFFECTS:
        assert len({words.parameter(p.name) for p in one.parameters}) == len(one.parameters)


def test_every_phase_is_in_the_table() -> None:
    phases = {phase for one in (*EFFECTS, *BILLIARDS_LAWS) for phase in one.phases} | OF_CAMERA
    assert phases <= set(words.PHASES)
    assert all("_" not in words.phase(name) for name in phases)


def test_groups_of_observations_are_places_and_times() -> None:
    assert words.group("since_contact", "0.1 to 0.2") == "0.1 to 0.2 s after a contact"
    assert words.group("phase", "free_roll") == "in free roll"
    assert words.group("all", "all") == "everywhere"
    assert words.direction(str(np.int64(1))) == "along the second axis"


def test_what_no_table_holds_is_still_legible() -> None:
    assert words.named("sticky_patch") == "sticky patch"
    assert words.phase("pocket_fall") == "in pocket fall"
