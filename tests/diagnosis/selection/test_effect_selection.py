"""The search for missing effects exhausts short windows before it extends them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import chi2
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.diagnosis_windows import split_into_segments
from diagnosis.fitting.hypothesis_fits import EffectFit, build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE, apply_noise_estimate, estimate_noise
from diagnosis.selection.effect_selection import (
    REFITS_PER_STEP,
    find_substitutes,
    needs_all_effects,
    search_effects,
    select_hypothesis,
)
from diagnosis.selection.hypotheses import EffectSearch, Hypothesis
from diagnosis.selection.hypothesis_trials import try_hypothesis
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene
from models.estimation.multiple_shooting.shooting_fit import ShootingFit
from models.physics.billiards.tables import TABLE_PRESETS

TRUTH = {"friction.mu": 0.02, "slope.slope_x": 2.0, "slope.slope_y": -1.0, "air_drag.k": 0.1}


def test_windows_grow_only_once_nothing_more_is_asked_for() -> None:
    problem = build_diagnosis_problem(Pucks(), WHITE_NOISE)
    filmed = film(np.random.default_rng(1), TRUTH, Filming(shots=8, fps=30))
    recordings = apply_noise_estimate(filmed, estimate_noise(filmed))
    whole = split_into_segments(problem, recordings)
    halves = tuple(
        half
        for one in whole
        for half in (one.select_rows(0, len(one.t) // 2), one.select_rows(len(one.t) // 2, len(one.t)))
    )  # fmt: skip
    extended: list[frozenset[str]] = []

    def longer(fitted: EffectFit) -> EffectFit:
        extended.append(frozenset(fitted.names))
        return fit_effects(problem, whole, fitted.names, fitted.forms, fitted.shared)

    search = search_effects(problem, fit_effects(problem, halves), longer)
    assert extended == [frozenset({"slope", "air_drag"})]
    assert select_hypothesis(search).names == frozenset({"slope", "air_drag"})
    assert len(select_hypothesis(search).fitted.segments) == len(whole)


def test_sets_that_share_an_effect_do_not_crowd_out_what_stands_in_for_it() -> None:
    """Short paths hardly separate viscous from quadratic drag; further effects beside the first are chance."""
    problem = build_diagnosis_problem(Pucks(), WHITE_NOISE)
    filmed = film(np.random.default_rng(2), {"friction.mu": 0.02, "viscous_drag.k": 0.2}, Filming(shots=6, seconds=0.5))
    base = Hypothesis(
        frozenset(),
        fit_effects(problem, split_into_segments(problem, apply_noise_estimate(filmed, estimate_noise(filmed)))),
    )
    search, twin = EffectSearch(problem, base, simulator_fit=base.fitted), frozenset({"air_drag"})
    beside = (), ("slope",), ("sideways",), ("lens_distortion",), ("slope", "sideways"), ("slope", "lens_distortion")
    for names in (twin, *(frozenset({"viscous_drag", *more}) for more in beside)):
        try_hypothesis(search, names, base)
    best = search.hypotheses[frozenset({"viscous_drag", "slope", "sideways"})]
    likelier = sorted(search.hypotheses.values(), key=lambda one: one.fitted.cost)[: REFITS_PER_STEP + 1]
    assert twin not in [one.names for one in likelier]
    assert twin in find_substitutes(search, best)


def test_an_effect_of_no_strength_is_not_needed_whatever_a_lost_window_costs_without_it() -> None:
    problem = build_diagnosis_problem(Pucks(), WHITE_NOISE)
    for drag, wanted in ((0.2, True), (0.0, False)):
        filmed = film(np.random.default_rng(3), {"friction.mu": 0.02, "viscous_drag.k": drag}, Filming(shots=6))
        base = fit_effects(problem, split_into_segments(problem, apply_noise_estimate(filmed, estimate_noise(filmed))))
        lost = replace(base, shooting=replace(base.shooting, cost=base.cost + 1e3))
        search = EffectSearch(problem, Hypothesis(frozenset(), lost), simulator_fit=lost)
        one = try_hypothesis(search, frozenset({"viscous_drag"}), search.base)
        search.record_shared_starts(one, frozenset())  # it has been begun like the larger one, and stays where it is
        assert needs_all_effects(search, one) is wanted


@pytest.mark.parametrize(("p_value", "is_needed"), [(1e-9, True), (0.0085, True), (0.012, False)])
def test_another_law_needs_no_strength_of_what_it_leaves_open(p_value: float, is_needed: bool) -> None:
    """The data do not determine a nose friction at its published value; the contact model is needed all the same.

    One search in a hundred may need a model by chance.
    """
    problem = build_diagnosis_problem(build_billiards_scene(TABLE_PRESETS["pool-9ft"], ()), WHITE_NOISE)
    t = np.arange(30) / 60
    segments = (
        Recording(0, np.arange(30), t, ("cue",), np.outer(t, (1.0, 0.5))[:, None], np.full((30, 1), 1e-3), TABLE_PLANE),
    )

    def claimed(cost: float, *names: str) -> EffectFit:
        free = problem.mask((*problem.scene.simulator_effects, *names))
        shared = np.where(free, problem.natural, problem.neutral(problem.simulator_forms))
        count = int(free.sum())
        shooting = SimpleNamespace(
            starts=(np.zeros(7),), shared=shared[free], covariance=np.eye(count), sigma=np.ones(count), cost=cost,
            inflation=1.0,
        )  # fmt: skip
        return EffectFit(segments, names, problem.simulator_forms, free, shared, cast(ShootingFit, shooting))

    base, law = claimed(0.0), claimed(0.0, "cushion_friction", "cushion_cloth")
    choices = len(EffectSearch(problem, Hypothesis(frozenset(), base), simulator_fit=base).choices)
    gain = chi2.isf(1 - (1 - p_value) ** (1 / choices), int(law.free.sum() - base.free.sum()))
    base = claimed(float(gain))
    search = EffectSearch(problem, Hypothesis(frozenset(), base), simulator_fit=base)
    one = search.hypotheses[frozenset({"cushion_law"})] = Hypothesis(frozenset({"cushion_law"}), law)
    search.record_shared_starts(one, frozenset())
    assert needs_all_effects(search, one) is is_needed
