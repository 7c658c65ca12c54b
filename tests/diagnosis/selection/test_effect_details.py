"""Companion effects and contact models are added to a hypothesis where the data require them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import SIGMA, TABLE, numbers, opening

from diagnosis.fitting.diagnosis_windows import fit_initial_windows
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.selection.effect_selection import find_substitutes, fit_without_effect, propose_hypotheses
from diagnosis.selection.hypotheses import EffectSearch, Hypothesis, compute_hypothesis_signatures
from diagnosis.selection.hypothesis_trials import (
    add_details,
    find_added_effects,
    find_details,
    refit_from,
    try_hypothesis,
)
from diagnosis.verdicts.candidate_probabilities import find_group
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene
from models.physics.billiards.simulation.parametrised_shot import ContactModels, pack_start, simulate_start

SPEED, POWER = "cushion_restitution_speed", "cushion_restitution_power"


def simulate_search(laws: ContactModels | None = None, **truth: float) -> EffectSearch:
    """Start an effect search on six simulated shots, with no effect tried yet."""
    shots = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        start, moving = opening(rng)
        t = np.arange(60) / 60
        run = simulate_start(pack_start(start, moving), moving, TABLE, numbers(**truth), laws or ContactModels(), 1.0)
        xy = run.states_at(t)[..., :2]
        xy = xy + SIGMA * rng.normal(size=xy.shape)
        shots.append(Recording(seed, np.arange(60), t, ("a", "b", "c"), xy, np.full(xy.shape[:2], SIGMA), TABLE_PLANE))
    problem = build_diagnosis_problem(build_billiards_scene(TABLE, tuple(shots)), WHITE_NOISE)
    base = fit_initial_windows(problem, tuple(shots))
    return EffectSearch(problem, Hypothesis(frozenset(), base), simulator_fit=base)


def test_a_curved_restitution_curve_is_added_to_the_effect_that_explains_it() -> None:
    search = simulate_search(cushion_restitution_power__power=0.4)
    detailed = add_details(search, try_hypothesis(search, frozenset({SPEED}), search.base))
    assert POWER in detailed.fitted.names
    assert POWER not in search.problem.candidates
    estimates = dict(zip((prior.name for prior in search.problem.priors), detailed.fitted.shared, strict=True))
    assert estimates[f"{POWER}.power"] == pytest.approx(0.4, abs=0.08)


def test_a_linear_restitution_curve_needs_no_companion_effect() -> None:
    search = simulate_search(cushion_restitution_speed__slope=0.06)
    assert add_details(search, try_hypothesis(search, frozenset({SPEED}), search.base)).fitted.names == (SPEED,)


def test_a_smaller_hypothesis_gets_the_details_of_the_larger_one() -> None:
    """Otherwise the larger one would be required for its details alone."""
    search = simulate_search(cushion_restitution_power__power=0.2)
    problem, base = search.problem, search.base.fitted
    smaller = fit_effects(problem, base.segments, (SPEED,))
    larger = fit_effects(problem, base.segments, (SPEED, "nap", POWER))
    assert refit_from(problem, smaller, larger, smaller.forms).names == (SPEED, POWER)
    assert find_details(problem, frozenset({"nap"})) == ()


def test_another_contact_model_is_tried_where_a_similar_effect_fits_but_shots_disagree() -> None:
    """Ball friction imitates Alciatore's contact model, with another strength in each shot."""
    search = simulate_search(ContactModels(ball="alciatore"), ball_friction__mu=0.0)
    problem, base = search.problem, search.base.fitted
    twin = Hypothesis(frozenset({"ball_friction"}), fit_effects(problem, base.segments, ("ball_friction",)))
    quiet = replace(twin.fitted, shooting=replace(twin.fitted.shooting, cost=0.9 * twin.fitted.value_count))
    search.hypotheses[twin.names] = twin = Hypothesis(twin.names, quiet)
    assert twin.fitted.lower_excess_cost == 0
    assert frozenset({"ball_friction", "ball_law"}) in propose_hypotheses(search, twin)


def test_a_smaller_hypothesis_may_take_the_form_of_the_larger_one() -> None:
    """Otherwise the added effect would be required for the form alone."""
    search = simulate_search(ContactModels("han_2005"), cushion_friction__mu=0.2)
    problem, segments, law = search.problem, search.base.fitted.segments, frozenset({"cushion_law"})
    for names, form in ((law, "mathavan_2010"), (law | {"nap"}, "han_2005")):
        fitted = fit_effects(problem, segments, find_added_effects(problem, names), (form, "inelastic"))
        search.hypotheses[names] = Hypothesis(names, fitted)
    wrong, larger = search.hypotheses[law].fitted, search.hypotheses[law | {"nap"}]
    reduced = fit_without_effect(search, larger, "nap")
    assert reduced.forms == ("han_2005", "inelastic")
    assert reduced.cost < larger.fitted.cost + 10 < wrong.cost


def test_another_contact_model_in_place_of_an_effect_stays_another_one() -> None:
    """With the model of the simulator it would be the same hypothesis under another name."""
    search = simulate_search(cushion_friction__mu=0.2)
    problem, segments = search.problem, search.base.fitted.segments
    friction, law = frozenset({"cushion_friction"}), frozenset({"cushion_law"})
    for names, form in ((friction, "mirror"), (law, "han_2005")):
        fitted = fit_effects(problem, segments, find_added_effects(problem, names), (form, "inelastic"))
        search.hypotheses[names] = Hypothesis(names, fitted)
    assert find_substitutes(search, search.hypotheses[friction]) == {law}
    assert search.hypotheses[law].fitted.forms == ("han_2005", "inelastic")


def test_a_contact_model_and_its_parameters_are_a_group_where_they_fit_equally_well() -> None:
    """A cushion without friction may lack friction, or another law that has it."""
    search = simulate_search(cushion_friction__mu=0.2)
    friction, law, nap = (frozenset({name}) for name in ("cushion_friction", "cushion_law", "nap"))
    fitted = fit_effects(search.problem, search.base.fitted.segments, ("cushion_friction",))
    for names in (friction, law, nap):
        search.hypotheses[names] = Hypothesis(names, fitted)
    without = compute_hypothesis_signatures(search, search.base)
    assert find_group(search, search.hypotheses[law], "cushion_law", without) == ("cushion_law", "cushion_friction")
    assert find_group(search, search.hypotheses[friction], "cushion_friction", without) == (
        "cushion_friction",
        "cushion_law",
    )
