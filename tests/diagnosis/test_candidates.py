"""What is said of the strength of an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.hypothesis_fits import fit, question_of
from diagnosis.verdicts.candidate_probabilities import strengths


def test_a_strength_that_no_shot_told_is_marked_and_others_are_not() -> None:
    question = question_of(Pucks(), 0.0)
    seen = film(np.random.default_rng(3), {"friction.mu": 0.02}, Filming(shots=3))
    sharp, blind = (tuple(replace(one, sigma=np.full_like(one.sigma, m)) for one in seen) for m in (1e-3, 1e3))
    nowhere = np.full(len(question.priors), np.inf)
    for shots, told in ((sharp, True), (blind, False)):
        fitted = fit(question, shots)
        (friction,) = strengths(question, fitted, nowhere, ("friction",))
        assert friction.prior_only != told
    (slope, *_) = strengths(question, fitted, nowhere, ("slope",))
    assert np.isinf(slope.sigma), "it was not fitted"
    assert not slope.prior_only
