"""Fits on wrong paths are restarted; shots that no simulated path comes near are recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Filming, Pucks, film

from diagnosis.fitting import window_continuation
from diagnosis.fitting.diagnosis_windows import fit_adaptively, split_into_segments
from diagnosis.fitting.hypothesis_fits import (
    DiagnosisProblem,
    EffectFit,
    build_diagnosis_problem,
    fit_effects,
    fit_start_states,
)
from diagnosis.fitting.shot_preparation import WHITE_NOISE, apply_noise_estimate, estimate_noise
from diagnosis.fitting.window_continuation import adopt_better_starts, find_unreachable_shots, restart_poor_shots
from models.core.recording import Recording

PROBLEM = build_diagnosis_problem(Pucks(), WHITE_NOISE)


def shots() -> tuple[Recording, ...]:
    filmed = film(np.random.default_rng(3), {"friction.mu": 0.02}, Filming(shots=5, fps=30))
    return apply_noise_estimate(filmed, estimate_noise(filmed))


def move_by_hand(one: Recording) -> Recording:
    """Add an oscillation of 30 cm with a period of about one second."""
    return replace(one, positions=one.positions + 0.3 * np.sin(6.0 * one.t)[:, None, None])


def fit_shots(problem: DiagnosisProblem, recordings: tuple[Recording, ...]) -> EffectFit:
    return fit_effects(problem, split_into_segments(problem, recordings))


def test_a_shot_in_which_a_hand_moved_a_body_is_not_followed() -> None:
    honest = shots()
    odd = tuple(move_by_hand(one) if one.shot == 2 else one for one in honest)
    assert find_unreachable_shots(PROBLEM, fit_adaptively(PROBLEM, honest)) == ()
    assert find_unreachable_shots(PROBLEM, fit_adaptively(PROBLEM, odd)) == (2,)


def test_where_most_shots_are_not_followed_the_simulator_is_at_fault() -> None:
    odd = tuple(move_by_hand(one) if one.shot > 1 else one for one in shots())
    assert find_unreachable_shots(PROBLEM, fit_adaptively(PROBLEM, odd)) == ()


def test_a_fit_that_is_lost_in_one_shot_begins_there_like_another() -> None:
    good = fit_shots(PROBLEM, shots())
    astray = (good.starts[0] + 0.3, *good.starts[1:])
    lost = replace(good, shooting=replace(good.shooting, starts=astray, cost=1e3 * good.cost))
    better = adopt_better_starts(PROBLEM, lost, good.starts)
    assert better.cost < 1.01 * good.cost
    np.testing.assert_allclose(better.starts[0], good.starts[0], atol=1e-3)


def test_a_fit_keeps_its_starts_where_others_are_no_better() -> None:
    good = fit_shots(PROBLEM, shots())
    assert adopt_better_starts(PROBLEM, good, good.starts).cost <= good.cost


def test_an_odd_shot_is_sought_under_the_numbers_that_the_others_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    honest, numbers = fit_shots(PROBLEM, shots()), []
    bent = fit_shots(PROBLEM, tuple(move_by_hand(one) if one.shot == 2 else one for one in shots()))
    others = fit_shots(PROBLEM, tuple(one for one in shots() if one.shot != 2))

    def record_call(
        problem: DiagnosisProblem, segments: tuple[Recording, ...], like: EffectFit, *how: object, retry_guesses: bool
    ) -> EffectFit:
        assert retry_guesses
        assert {segment.shot for segment in segments} == {2}
        numbers.append(like.shared)
        return fit_start_states(problem, segments, like, retry_guesses=retry_guesses)

    monkeypatch.setattr(window_continuation, "fit_start_states", record_call)
    assert restart_poor_shots(PROBLEM, bent).cost <= bent.cost
    assert not np.allclose(bent.shared, others.shared, atol=1e-4)
    np.testing.assert_allclose(numbers[0], others.shared, atol=1e-6)
    assert restart_poor_shots(PROBLEM, honest) is honest
