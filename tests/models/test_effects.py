"""Every effect of the catalogue says what a user and a fit need of it."""

from __future__ import annotations

import pytest

from models.physics.billiards.calibration_errors import ON_PICTURE
from models.physics.billiards.parameters import BALL_LAWS, CUSHION_LAWS, NAMES, neutral
from models.physics.effect import Effect, Prior
from models.physics.effects.catalogue import BILLIARDS, BILLIARDS_LAWS, prior_of
from pipeline.engine.source_fingerprint import ROOT, source_hashes


@pytest.mark.parametrize("effect", BILLIARDS, ids=lambda effect: effect.name)
def test_an_effect_has_a_place_parameters_and_a_source(effect: Effect) -> None:
    assert effect.phases
    assert effect.parameters
    assert effect.reference
    assert (ROOT / "models" / "effects" / f"{effect.name}.py").is_file(), "one file per effect, named as users know it"
    assert [prior_of(effect.name, prior.name) for prior in effect.parameters] == list(effect.parameters)


def test_names_are_unique() -> None:
    names = [effect.name for effect in BILLIARDS]
    assert len(set(names)) == len(names)


def test_the_engine_knows_every_parameter_of_the_catalogue_that_acts_on_balls() -> None:
    named = [f"{e.name}.{p.name}" for e in BILLIARDS for p in e.parameters if e.kind in ("physics", "detail")]
    assert set(NAMES) == {name for name in named if not name.startswith("unequal") and name not in ON_PICTURE}


def test_an_absent_effect_is_what_the_engine_takes_for_absent() -> None:
    absent = {f"{e.name}.{p.name}": value for e in BILLIARDS for p, value in zip(e.parameters, e.neutral, strict=True)}
    assert [absent[name] for name in NAMES] == neutral().tolist()


def test_the_engine_plays_every_law_of_the_catalogue() -> None:
    forms = {choice.name: set(choice.forms) for choice in BILLIARDS_LAWS}
    assert forms["cushion_law"] <= set(CUSHION_LAWS)
    assert forms["ball_law"] <= set(BALL_LAWS)


def test_partners_are_effects_or_laws() -> None:
    known = {entry.name for entry in (*BILLIARDS, *BILLIARDS_LAWS)}
    assert {name for entry in (*BILLIARDS, *BILLIARDS_LAWS) for name in entry.partners} <= known


def test_a_prior_outside_its_bounds_is_refused() -> None:
    with pytest.raises(ValueError, match="within its bounds"):
        Prior("mu", "1", 2.0, 0.1, False, (0.0, 1.0))


def test_an_unknown_effect_is_named_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"rolling_resistance.*no glue\.mu"):
        prior_of("glue", "mu")


def test_the_fit_stands_on_every_effect_and_detection_on_none() -> None:
    behind = {stage: source_hashes(f"pipeline.stages.{stage}") for stage in ("fit", "detect", "track")}
    for effect in BILLIARDS:
        path = f"models/effects/{effect.name}.py"
        assert path in behind["fit"]
        assert path not in behind["detect"]
        assert path not in behind["track"]
