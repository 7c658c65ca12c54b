"""The search for what is missing: everything that short windows ask for comes before longer ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.diagnosis_windows import stretches
from diagnosis.fitting.hypothesis_fits import Fitted, fit, question_of
from diagnosis.fitting.noise_estimation import estimate_noise, with_noise
from diagnosis.selection.effect_selection import TRIED, adopted, needed, search, stand_ins
from diagnosis.selection.hypotheses import Hypothesis, Search
from diagnosis.selection.hypothesis_trials import tried
from models.estimation.gap_scenes.billiards_scene import billiards_scene
from models.estimation.gap_scenes.gap_scene import Recording
from models.estimation.multiple_shooting.shooting_fit import Shooting
from models.physics.billiards.tables import PRESETS

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


def test_sets_that_share_an_effect_do_not_crowd_out_what_stands_in_for_it() -> None:
    """Short paths hardly tell a drag with speed from one with its square; what else is added to the first is chance."""
    question = question_of(Pucks(), 0.0)
    filmed = film(np.random.default_rng(2), {"friction.mu": 0.02, "viscous_drag.k": 0.2}, Filming(shots=6, seconds=0.5))
    base = Hypothesis(frozenset(), fit(question, stretches(question, with_noise(filmed, estimate_noise(filmed)))))
    state, twin = Search(question, base, alone=base.fitted), frozenset({"air_drag"})
    beside = (), ("slope",), ("sideways",), ("lens_distortion",), ("slope", "sideways"), ("slope", "lens_distortion")
    for names in (twin, *(frozenset({"viscous_drag", *more}) for more in beside)):
        tried(state, names, base)
    best = state.tried[frozenset({"viscous_drag", "slope", "sideways"})]
    likelier = sorted(state.tried.values(), key=lambda one: one.fitted.cost)[: TRIED + 1]
    assert twin not in [one.names for one in likelier]
    assert twin in stand_ins(state, best)


def test_an_effect_of_no_strength_is_not_needed_whatever_a_lost_window_costs_without_it() -> None:
    question = question_of(Pucks(), 0.0)
    for drag, wanted in ((0.2, True), (0.0, False)):
        filmed = film(np.random.default_rng(3), {"friction.mu": 0.02, "viscous_drag.k": drag}, Filming(shots=6))
        base = fit(question, stretches(question, with_noise(filmed, estimate_noise(filmed))))
        lost = replace(base, shooting=replace(base.shooting, cost=base.cost + 1e3))
        state = Search(question, Hypothesis(frozenset(), lost), alone=lost)
        one = tried(state, frozenset({"viscous_drag"}), state.base)
        state.lend(one, frozenset())  # it has been begun like the larger one, and stays where it is
        assert needed(state, one) is wanted


def test_another_law_needs_no_strength_of_what_it_leaves_open() -> None:
    """Of a friction under the nose that is as the books have it nothing is told; the law is needed all the same."""
    question = question_of(billiards_scene(PRESETS["pool-9ft"], ()), 0.0)
    t = np.arange(30) / 60
    pieces = (Recording(0, np.arange(30), t, ("cue",), np.outer(t, (1.0, 0.5))[:, None], np.full((30, 1), 1e-3)),)

    def claimed(cost: float, *names: str) -> Fitted:
        free = question.mask((*question.scene.assumed, *names))
        shared = np.where(free, question.natural, question.neutral)
        count = int(free.sum())
        found = Shooting(
            (np.zeros(7),), shared[free], np.eye(count), np.zeros(count, bool), cost, 1.0, -cost, 1.0, (), True
        )
        return Fitted(pieces, names, question.assumed_forms, free, shared, found)

    base, law = claimed(5000.0), claimed(50.0, "cushion_friction", "cushion_cloth")
    state = Search(question, Hypothesis(frozenset(), base), alone=base)
    one = state.tried[frozenset({"cushion_law"})] = Hypothesis(frozenset({"cushion_law"}), law)
    state.lend(one, frozenset())
    assert needed(state, one)
