"""What a fit offers to those that begin from it: starts that follow its numbers, and what it leaves unexplained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.diagnosis_windows import stretches
from diagnosis.fitting.hypothesis_fits import Fitted, Question, fit, look, nearest, question_of
from diagnosis.fitting.noise_estimation import estimate_noise, with_noise
from diagnosis.selection.effect_selection import chance, lacking, needed
from diagnosis.selection.hypotheses import Hypothesis, Search
from diagnosis.selection.unknown_effects import explained
from models.estimation.gap_scenes.gap_scene import Recording
from models.estimation.multiple_shooting.shooting_windows import glance

PLAIN = {"friction.mu": 0.02}


def fitted(*truths: dict[str, float]) -> tuple[Question, Fitted]:
    """Two shots of each truth, and what the simulator alone makes of them."""
    question, shots = question_of(Pucks(), 0.0), list[Recording]()
    for truth in truths:
        filmed = film(np.random.default_rng(len(shots)), truth, Filming(shots=2))
        shots += [replace(one, shot=len(shots) + k) for k, one in enumerate(filmed)]
    return question, fit(question, stretches(question, with_noise(tuple(shots), estimate_noise(tuple(shots)))))


def misfit(question: Question, like: Fitted, starts: tuple[np.ndarray, ...], shared: np.ndarray) -> float:
    model = question.scene.model(like.pieces, like.forms)
    return sum(float(np.square(glance(model, k, one, shared).misfit).sum()) for k, one in enumerate(starts))


def test_starts_answer_to_what_is_changed() -> None:
    question, alone = fitted(PLAIN)
    step = np.where(question.mask(("viscous_drag",)), 0.05, 0.0)
    moved = look(question, alone).told.answered(alone.starts, step)
    left = [misfit(question, alone, starts, alone.shared + step) for starts in (alone.starts, moved)]
    assert left[1] < 0.1 * left[0]


def test_of_starts_that_are_offered_each_shot_takes_the_nearest() -> None:
    question, alone = fitted(PLAIN)
    off = tuple(start + 0.01 for start in alone.starts)
    mixed = (off[0], *alone.starts[1:]), (alone.starts[0], *off[1:])
    taken = nearest(question, alone, alone.forms, alone.shared, list(mixed))
    assert all(one is start for one, start in zip(taken, alone.starts, strict=True))


def test_an_effect_that_only_stands_in_for_what_shots_disagree_about_is_not_needed() -> None:
    both = frozenset({"slope", "air_drag"})
    for drag, steeper, wanted in ((0.003, 0.0, True), (0.0005, 1.0, False)):
        leaning = {**PLAIN, "slope.slope_x": 2.0, "air_drag.k": drag}
        question, alone = fitted(leaning, {**leaning, "slope.slope_x": 2.0 + steeper})
        state = Search(question, Hypothesis(frozenset(), alone), alone=alone)
        for names in (both, *(frozenset({name}) for name in both)):
            state.tried[names] = Hypothesis(names, fit(question, alone.pieces, tuple(sorted(names))))
        assert state.tried[both].fitted.excess == 0
        assert max(chance(state, state.tried[both], name) for name in both) < 0.001
        assert needed(state, state.tried[both]) is wanted


def test_what_lacks_an_effect_is_begun_anew_once_the_whole_has_found_better_starts() -> None:
    question, alone = fitted(PLAIN)
    both = frozenset({"slope", "air_drag"})
    found = fit(question, alone.pieces, tuple(sorted(both)))
    worse = replace(found, shooting=replace(found.shooting, cost=found.cost + 50.0))
    without = fit(question, alone.pieces, ("slope",))
    stuck = replace(without, shooting=replace(without.shooting, cost=without.cost + 20.0))
    state = Search(question, Hypothesis(frozenset(), alone), alone=alone)
    whole = state.tried[both] = Hypothesis(both, worse)
    state.lend(whole, frozenset({"slope"}))
    state.tried[frozenset({"slope"})] = Hypothesis(frozenset({"slope"}), stuck)
    assert lacking(state, whole, "air_drag") is stuck
    whole = state.improve(whole, found)
    assert lacking(state, whole, "air_drag").cost < without.cost + 1.0


def test_what_shots_contradict_each_other_about_is_not_explained() -> None:
    shares = []
    for steeper in (0.0, 0.3):
        question, alone = fitted({**PLAIN, "slope.slope_x": 2.0}, {**PLAIN, "slope.slope_x": 2.0 + steeper})
        found = fit(question, alone.pieces, ("slope",))
        louder = replace(found, shooting=replace(found.shooting, chi2_per_dof=1.0))
        shares.append(explained(alone, louder, look(question, found).told, None)[0])
    assert shares[0] > 0.999
    assert shares[1] < 0.995
