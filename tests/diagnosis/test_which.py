"""The search for what is missing: everything that short windows ask for comes before longer ones."""

from __future__ import annotations

import numpy as np
from pucks import Filming, Pucks, film

from diagnosis.fitting import Fitted, fit, question_of
from diagnosis.noise import estimate_noise, with_noise
from diagnosis.pieces import stretches
from diagnosis.which import adopted, search

TRUTH = {"friction.mu": 0.02, "slope.slope_x": 2.0, "slope.slope_y": -1.0, "air_drag.k": 0.1}


def test_windows_grow_only_once_nothing_more_is_asked_for() -> None:
    question = question_of(Pucks(), 0.0)
    filmed = film(np.random.default_rng(1), TRUTH, Filming(shots=8, fps=30))
    recordings = with_noise(filmed, estimate_noise(filmed))
    whole = stretches(question, recordings)
    halves = tuple(
        half
        for one in whole
        for half in (one.rows(0, len(one.t) // 2), one.rows(len(one.t) // 2, len(one.t)))
    )  # fmt: skip
    asked: list[frozenset[str]] = []

    def longer(found: Fitted) -> Fitted:
        asked.append(frozenset(found.names))
        return fit(question, whole, found.names, found.forms, found.shared)

    state = search(question, fit(question, halves), longer)
    assert asked == [frozenset({"slope", "air_drag"})]
    assert adopted(state).names == frozenset({"slope", "air_drag"})
    assert len(adopted(state).fitted.pieces) == len(whole)
