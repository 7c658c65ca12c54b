"""Strengths of effects are reported, and marked where the data do not determine them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.verdicts.candidate_probabilities import summarize_strengths
from diagnosis.verdicts.diagnosis_report import list_missed_strengths


def test_a_strength_that_no_shot_told_is_marked_and_others_are_not() -> None:
    problem = build_diagnosis_problem(Pucks(), WHITE_NOISE)
    filmed = film(np.random.default_rng(3), {"friction.mu": 0.02}, Filming(shots=3))
    sharp, blind = (tuple(replace(one, sigma=np.full_like(one.sigma, m)) for one in filmed) for m in (1e-3, 1e3))
    nowhere = np.full(len(problem.priors), np.inf)
    for shots, is_determined in ((sharp, True), (blind, False)):
        fitted = fit_effects(problem, shots)
        (friction,) = summarize_strengths(problem, fitted, nowhere, ("friction",))
        assert friction.prior_only != is_determined
    (slope, *_) = summarize_strengths(problem, fitted, nowhere, ("slope",))
    assert np.isinf(slope.sigma), "it was not fitted"
    assert not slope.prior_only


def test_only_the_strengths_that_shots_cannot_show_are_listed_where_each_may_be_missing_alone() -> None:
    problem = build_diagnosis_problem(Pucks(), WHITE_NOISE)
    numbers = np.flatnonzero(problem.mask(("slope",)))
    names = tuple(problem.priors[k].name for k in numbers)
    is_missed = np.zeros(len(problem.priors), bool)
    assert list_missed_strengths(problem, "slope", is_missed, True) == ()
    is_missed[numbers[1]] = True
    assert list_missed_strengths(problem, "slope", is_missed, True) == names[1:]
    assert list_missed_strengths(problem, "slope", is_missed, False) == ("slope",)
    is_missed[numbers] = True
    assert list_missed_strengths(problem, "slope", is_missed, True) == ("slope",)
