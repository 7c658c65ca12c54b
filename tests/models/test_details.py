"""What the laws of named effects leave open is told with them, where the data ask for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import SIGMA, TABLE, numbers, opening

from diagnosis.fitting.diagnosis_windows import fit_begun
from diagnosis.fitting.hypothesis_fits import fit, question_of
from diagnosis.selection.effect_selection import lacking, proposals
from diagnosis.selection.hypotheses import Hypothesis, Search, signatures_of
from diagnosis.selection.hypothesis_trials import begun_from, details_of, effects_of, tried, with_details
from diagnosis.verdicts.candidate_probabilities import group_of
from models.estimation.gap_scenes.billiards_scene import billiards_scene
from models.estimation.gap_scenes.gap_scene import Recording
from models.physics.billiards.simulation.parametrised_shot import Laws, packed, played

SPEED, POWER = "cushion_restitution_speed", "cushion_restitution_power"


def searched(laws: Laws | None = None, **truth: float) -> Search:
    """Nothing tried yet, of six shots that begin with a strike."""
    shots = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        start, moving = opening(rng)
        t = np.arange(60) / 60
        run = played(packed(start, moving), moving, TABLE, numbers(**truth), laws or Laws(), 1.0)
        xy = run.at(t)[..., :2]
        xy = xy + SIGMA * rng.normal(size=xy.shape)
        shots.append(Recording(seed, np.arange(60), t, ("a", "b", "c"), xy, np.full(xy.shape[:2], SIGMA)))
    question = question_of(billiards_scene(TABLE, tuple(shots)), 0.0)
    base = fit_begun(question, tuple(shots))
    return Search(question, Hypothesis(frozenset(), base), alone=base)


def test_a_curved_fall_of_restitution_is_told_with_the_effect_that_is_named() -> None:
    state = searched(cushion_restitution_power__power=0.4)
    found = with_details(state, tried(state, frozenset({SPEED}), state.base))
    assert POWER in found.fitted.names
    assert POWER not in state.question.candidates
    told = dict(zip((prior.name for prior in state.question.priors), found.fitted.shared, strict=True))
    assert told[f"{POWER}.power"] == pytest.approx(0.4, abs=0.08)


def test_what_is_straight_needs_no_detail() -> None:
    state = searched(cushion_restitution_speed__slope=0.06)
    assert with_details(state, tried(state, frozenset({SPEED}), state.base)).fitted.names == (SPEED,)


def test_a_smaller_hypothesis_gets_the_details_of_the_larger_one() -> None:
    """Or the larger one would be needed for them alone."""
    state = searched(cushion_restitution_power__power=0.2)
    question, base = state.question, state.base.fitted
    smaller = fit(question, base.pieces, (SPEED,))
    larger = fit(question, base.pieces, (SPEED, "nap", POWER))
    assert begun_from(question, smaller, larger, smaller.forms).names == (SPEED, POWER)
    assert details_of(question, frozenset({"nap"})) == ()


def test_another_law_is_tried_where_its_twin_leaves_little_but_shots_disagree() -> None:
    """Friction of balls stands for Alciatore's law, of another strength in each shot."""
    state = searched(Laws(ball="alciatore"), ball_friction__mu=0.0)
    question, base = state.question, state.base.fitted
    twin = Hypothesis(frozenset({"ball_friction"}), fit(question, base.pieces, ("ball_friction",)))
    quiet = replace(twin.fitted, shooting=replace(twin.fitted.shooting, cost=0.9 * twin.fitted.observations))
    state.tried[twin.names] = twin = Hypothesis(twin.names, quiet)
    assert twin.fitted.excess == 0
    assert frozenset({"ball_friction", "ball_law"}) in proposals(state, twin)


def test_a_smaller_hypothesis_may_take_the_form_of_the_larger_one() -> None:
    """Or what is added would be needed for the form alone."""
    state = searched(Laws("han_2005"), cushion_friction__mu=0.2)
    question, pieces, law = state.question, state.base.fitted.pieces, frozenset({"cushion_law"})
    for names, form in ((law, "mathavan_2010"), (law | {"nap"}, "han_2005")):
        fitted = fit(question, pieces, effects_of(question, names), (form, "inelastic"))
        state.tried[names] = Hypothesis(names, fitted)
    wrong, larger = state.tried[law].fitted, state.tried[law | {"nap"}]
    found = lacking(state, larger, "nap")
    assert found.forms == ("han_2005", "inelastic")
    assert found.cost < larger.fitted.cost + 10 < wrong.cost


def test_a_law_and_what_it_brings_are_a_group_where_they_do_as_well() -> None:
    """A cushion without friction may lack friction, or another law that has it."""
    state = searched(cushion_friction__mu=0.2)
    friction, law, nap = (frozenset({name}) for name in ("cushion_friction", "cushion_law", "nap"))
    fitted = fit(state.question, state.base.fitted.pieces, ("cushion_friction",))
    for names in (friction, law, nap):
        state.tried[names] = Hypothesis(names, fitted)
    without = signatures_of(state, state.base)
    assert group_of(state, state.tried[law], "cushion_law", without) == ("cushion_law", "cushion_friction")
    assert group_of(state, state.tried[friction], "cushion_friction", without) == ("cushion_friction", "cushion_law")
