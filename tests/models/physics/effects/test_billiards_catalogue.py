"""Every effect of the catalogue has what a user and a fit need."""

from __future__ import annotations

import pytest

from models.physics.billiards.contact_models import BALL_MODELS, CUSHION_MODELS
from models.physics.billiards.parameter_vector import ENGINE_EFFECTS, PARAMETER_NAMES, neutral_parameters
from models.physics.billiards.simulation.parametrised_shot import IMAGE_PARAMETERS
from models.physics.billiards.simulation.table_physics import BILLIARDS_MODEL_CHOICES
from models.physics.effect import Effect, Prior
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS, find_prior
from pipeline.engine.source_fingerprint import ROOT, hash_sources

EFFECTS = ROOT / "models" / "physics" / "effects"
STAGES = ("explain_stage", "detect_stage", "track_stage")


@pytest.mark.parametrize("effect", BILLIARDS_EFFECTS, ids=lambda effect: effect.name)
def test_an_effect_has_a_place_parameters_and_a_source(effect: Effect) -> None:
    assert effect.phases
    assert effect.parameters
    assert effect.reference
    assert len(list(EFFECTS.glob(f"*/{effect.name}.py"))) == 1, "one file per effect, with the name that users write"
    assert [find_prior(effect.name, prior.name) for prior in effect.parameters] == list(effect.parameters)


def test_names_are_unique() -> None:
    names = [effect.name for effect in BILLIARDS_EFFECTS]
    assert len(set(names)) == len(names)


def test_the_order_of_candidates_and_parameters_is_explicit() -> None:
    assert [effect.rank for effect in BILLIARDS_EFFECTS] == list(range(len(BILLIARDS_EFFECTS)))
    slots = [effect.slot for effect in ENGINE_EFFECTS]
    assert slots == list(range(len(ENGINE_EFFECTS)))
    assert PARAMETER_NAMES[:2] == ("sliding_friction.mu", "rolling_resistance.mu")
    assert CUSHION_MODELS == ("mirror", "han_2005", "mathavan_2010", "stronge")
    assert BALL_MODELS == ("elastic", "inelastic", "alciatore", "mass_spring")


def test_the_engine_knows_every_parameter_of_the_catalogue_that_acts_on_balls() -> None:
    moving = ("physics", "detail", "probe")
    named = [f"{e.name}.{p.name}" for e in BILLIARDS_EFFECTS for p in e.parameters if e.kind in moving]
    assert set(PARAMETER_NAMES) == {
        name for name in named if not name.startswith("unequal") and name not in IMAGE_PARAMETERS
    }


def test_an_absent_effect_is_what_the_engine_takes_for_absent() -> None:
    absent = {
        f"{e.name}.{p.name}": value for e in BILLIARDS_EFFECTS for p, value in zip(e.parameters, e.neutral, strict=True)
    }
    assert [absent[name] for name in PARAMETER_NAMES] == neutral_parameters().tolist()


def test_the_engine_plays_every_law_of_the_catalogue() -> None:
    forms = {choice.name: set(choice.forms) for choice in BILLIARDS_MODEL_CHOICES}
    assert forms["cushion_law"] <= set(CUSHION_MODELS)
    assert forms["ball_law"] <= set(BALL_MODELS)


def test_partners_are_effects_or_laws() -> None:
    entries = (*BILLIARDS_EFFECTS, *BILLIARDS_MODEL_CHOICES)
    assert {name for entry in entries for name in entry.partners} <= {entry.name for entry in entries}


def test_a_prior_outside_its_bounds_is_refused() -> None:
    with pytest.raises(ValueError, match="within its bounds"):
        Prior("mu", "1", 2.0, 0.1, False, (0.0, 1.0))


def test_an_unknown_effect_is_named_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"rolling_resistance.*no glue\.mu"):
        find_prior("glue", "mu")


def test_the_fit_depends_on_every_effect_and_detection_on_none() -> None:
    sources = {stage: hash_sources(f"pipeline.stages.{stage}").keys() for stage in STAGES}
    files = {str(next(EFFECTS.glob(f"*/{effect.name}.py")).relative_to(ROOT)) for effect in BILLIARDS_EFFECTS}
    fit, *others = STAGES
    assert files <= sources[fit]
    for stage in others:
        assert not files & sources[stage]
