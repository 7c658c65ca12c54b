"""A fit offers start states and a lack of fit to the fits that continue it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.diagnosis_windows import split_into_segments
from diagnosis.fitting.hypothesis_fits import (
    DiagnosisProblem,
    EffectFit,
    build_diagnosis_problem,
    fit_effects,
    linearize_fit,
    select_best_starts,
)
from diagnosis.fitting.shot_preparation import WHITE_NOISE, apply_noise_estimate, estimate_noise
from diagnosis.selection.effect_selection import effect_p_value, fit_without_effect, needs_all_effects
from diagnosis.selection.hypotheses import EffectSearch, Hypothesis
from diagnosis.selection.unknown_effects import estimate_explained_share
from models.core.recording import Recording
from models.estimation.multiple_shooting.shooting_fit import ShootingFit
from models.estimation.multiple_shooting.shooting_windows import simulate_window

PLAIN = {"friction.mu": 0.02}


def fit_plain(*truths: dict[str, float]) -> tuple[DiagnosisProblem, EffectFit]:
    """Fit the simulator alone to two shots of each truth."""
    problem, shots = build_diagnosis_problem(Pucks(), WHITE_NOISE), list[Recording]()
    for truth in truths:
        filmed = film(np.random.default_rng(len(shots)), truth, Filming(shots=2))
        shots += [replace(one, shot=len(shots) + k) for k, one in enumerate(filmed)]
    return problem, fit_effects(
        problem, split_into_segments(problem, apply_noise_estimate(tuple(shots), estimate_noise(tuple(shots))))
    )


def misfit(problem: DiagnosisProblem, like: EffectFit, starts: tuple[np.ndarray, ...], shared: np.ndarray) -> float:
    model = problem.scene.build_model(like.segments, like.forms)
    return sum(float(np.square(simulate_window(model, k, one, shared).residual).sum()) for k, one in enumerate(starts))


def test_starts_answer_to_what_is_changed() -> None:
    problem, alone = fit_plain(PLAIN)
    step = np.where(problem.mask(("viscous_drag",)), 0.05, 0.0)
    moved = linearize_fit(problem, alone).shot_information.shift_starts(alone.starts, step)
    left = [misfit(problem, alone, starts, alone.shared + step) for starts in (alone.starts, moved)]
    assert left[1] < 0.1 * left[0]


def test_of_starts_that_are_offered_each_shot_takes_the_nearest() -> None:
    problem, alone = fit_plain(PLAIN)
    off = tuple(start + 0.01 for start in alone.starts)
    mixed = (off[0], *alone.starts[1:]), (alone.starts[0], *off[1:])
    taken = select_best_starts(problem, alone, alone.forms, alone.shared, list(mixed))
    assert all(one is start for one, start in zip(taken, alone.starts, strict=True))


def test_an_effect_that_only_stands_in_for_what_shots_disagree_about_is_not_needed() -> None:
    both = frozenset({"slope", "air_drag"})
    for drag, steeper, wanted in ((0.003, 0.0, True), (0.0005, 1.0, False)):
        leaning = {**PLAIN, "slope.slope_x": 2.0, "air_drag.k": drag}
        problem, alone = fit_plain(leaning, {**leaning, "slope.slope_x": 2.0 + steeper})
        search = EffectSearch(problem, Hypothesis(frozenset(), alone), simulator_fit=alone)
        for names in (both, *(frozenset({name}) for name in both)):
            search.hypotheses[names] = Hypothesis(names, fit_effects(problem, alone.segments, tuple(sorted(names))))
        assert search.hypotheses[both].fitted.lower_excess_cost == 0
        assert max(effect_p_value(search, search.hypotheses[both], name) for name in both) < 0.001
        assert needs_all_effects(search, search.hypotheses[both]) is wanted


def test_what_lacks_an_effect_is_begun_anew_once_the_whole_has_found_better_starts() -> None:
    problem, alone = fit_plain(PLAIN)
    both = frozenset({"slope", "air_drag"})
    both_fit = fit_effects(problem, alone.segments, tuple(sorted(both)))
    worse = replace(both_fit, shooting=replace(both_fit.shooting, cost=both_fit.cost + 50.0))
    without = fit_effects(problem, alone.segments, ("slope",))
    stuck = replace(without, shooting=replace(without.shooting, cost=without.cost + 20.0))
    search = EffectSearch(problem, Hypothesis(frozenset(), alone), simulator_fit=alone)
    whole = search.hypotheses[both] = Hypothesis(both, worse)
    search.record_shared_starts(whole, frozenset({"slope"}))
    search.hypotheses[frozenset({"slope"})] = Hypothesis(frozenset({"slope"}), stuck)
    assert fit_without_effect(search, whole, "air_drag") is stuck
    whole = search.replace_fit(whole, both_fit)
    assert fit_without_effect(search, whole, "air_drag").cost < without.cost + 1.0


def test_what_shots_contradict_each_other_about_is_not_explained() -> None:
    shares = []
    for steeper in (0.0, 0.3):
        problem, alone = fit_plain({**PLAIN, "slope.slope_x": 2.0}, {**PLAIN, "slope.slope_x": 2.0 + steeper})
        slope_fit = fit_effects(problem, alone.segments, ("slope",))
        louder = replace(slope_fit, shooting=cast(ShootingFit, SimpleNamespace(cost=slope_fit.cost, chi2_per_dof=1.0)))
        shares.append(
            estimate_explained_share(alone, louder, linearize_fit(problem, slope_fit).shot_information, None)[0]
        )
    assert shares[0] > 0.999
    assert shares[1] < 0.995
