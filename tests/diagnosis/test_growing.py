"""Fits that follow wrong paths are begun again, and shots that no path comes near are told from the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Filming, Pucks, film

from diagnosis.fitting import window_growth
from diagnosis.fitting.diagnosis_windows import fit_adaptively, stretches
from diagnosis.fitting.hypothesis_fits import Fitted, Question, fit, follow, question_of
from diagnosis.fitting.noise_estimation import estimate_noise, with_noise
from diagnosis.fitting.window_growth import begun_like, not_followed, sought_anew
from models.estimation.gap_scenes.gap_scene import Recording

QUESTION = question_of(Pucks(), 0.0)


def shots() -> tuple[Recording, ...]:
    filmed = film(np.random.default_rng(3), {"friction.mu": 0.02}, Filming(shots=5, fps=30))
    return with_noise(filmed, estimate_noise(filmed))


def moved_by_hand(one: Recording) -> Recording:
    """To and fro by 30 cm, once a second."""
    return replace(one, places=one.places + 0.3 * np.sin(6.0 * one.t)[:, None, None])


def fitted(question: Question, recordings: tuple[Recording, ...]) -> Fitted:
    return fit(question, stretches(question, recordings))


def test_a_shot_in_which_a_hand_moved_a_body_is_not_followed() -> None:
    honest = shots()
    odd = tuple(moved_by_hand(one) if one.shot == 2 else one for one in honest)
    assert not_followed(QUESTION, fit_adaptively(QUESTION, honest)) == ()
    assert not_followed(QUESTION, fit_adaptively(QUESTION, odd)) == (2,)


def test_where_most_shots_are_not_followed_the_simulator_is_at_fault() -> None:
    odd = tuple(moved_by_hand(one) if one.shot > 1 else one for one in shots())
    assert not_followed(QUESTION, fit_adaptively(QUESTION, odd)) == ()


def test_a_fit_that_is_lost_in_one_shot_begins_there_like_another() -> None:
    found = fitted(QUESTION, shots())
    astray = (found.starts[0] + 0.3, *found.starts[1:])
    lost = replace(found, shooting=replace(found.shooting, starts=astray, cost=1e3 * found.cost))
    better = begun_like(QUESTION, lost, found.starts)
    assert better.cost < 1.01 * found.cost
    np.testing.assert_allclose(better.starts[0], found.starts[0], atol=1e-3)


def test_a_fit_keeps_its_starts_where_others_are_no_better() -> None:
    found = fitted(QUESTION, shots())
    assert begun_like(QUESTION, found, found.starts).cost <= found.cost


def test_an_odd_shot_is_sought_under_the_numbers_that_the_others_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    honest, numbers = fitted(QUESTION, shots()), []
    bent = fitted(QUESTION, tuple(moved_by_hand(one) if one.shot == 2 else one for one in shots()))
    others = fitted(QUESTION, tuple(one for one in shots() if one.shot != 2))

    def followed(question: Question, pieces: tuple[Recording, ...], like: Fitted, *how: object, anew: bool) -> Fitted:
        assert anew
        assert {piece.shot for piece in pieces} == {2}
        numbers.append(like.shared)
        return follow(question, pieces, like, anew=anew)

    monkeypatch.setattr(window_growth, "follow", followed)
    assert sought_anew(QUESTION, bent).cost <= bent.cost
    assert not np.allclose(bent.shared, others.shared, atol=1e-4)
    np.testing.assert_allclose(numbers[0], others.shared, atol=1e-6)
    assert sought_anew(QUESTION, honest) is honest
