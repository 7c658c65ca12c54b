"""The sign-flip test of a named effect holds for any noise, and finds effects on which all shots agree."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.fitting.hypothesis_fits import ShotInformation, build_diagnosis_problem
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.verdicts.candidate_probabilities import flip_gains, flip_signs
from models.core.typing import FloatArray
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene

SHOTS = 9
PROBLEM = build_diagnosis_problem(build_sliding_scene(("sliding_friction",)), WHITE_NOISE)
FREE = PROBLEM.mask(("sliding_friction",))


def make_information(rng: np.random.Generator, pull: float) -> ShotInformation:
    """Shots of very different weight with noise of infinite variance, and a pull towards air drag."""
    p = len(PROBLEM.priors)
    information = np.array([np.diag(rng.uniform(1, 50, p)) + rng.uniform(0, 0.5) for _ in range(SHOTS)])
    score: FloatArray = rng.standard_t(1.5, (SHOTS, p)) * rng.lognormal(0, 2, (SHOTS, 1))
    score[:, PROBLEM.mask(("air_drag",))] += pull * np.abs(score).max()
    return ShotInformation(np.arange(SHOTS), information, score, ())


def test_p_values_hold_without_an_effect_whatever_the_noise() -> None:
    rng = np.random.default_rng(0)
    p = np.array([flip_signs(PROBLEM, make_information(rng, 0.0), FREE, "air_drag", rng) for _ in range(300)])
    for level in (0.05, 0.1, 0.3):
        assert (p <= level).mean() <= level + 2 * np.sqrt(level * (1 - level) / len(p))


def test_shots_that_agree_give_the_smallest_p_value_of_their_number() -> None:
    rng = np.random.default_rng(1)
    assert flip_signs(PROBLEM, make_information(rng, 3.0), FREE, "air_drag", rng) == pytest.approx(2 ** (1 - SHOTS))


def test_an_effect_without_strength_and_too_few_shots_are_not_tested() -> None:
    rng = np.random.default_rng(2)
    assert np.isnan(flip_signs(PROBLEM, make_information(rng, 3.0), FREE, "no such effect", rng))
    whole = make_information(rng, 3.0)
    two = ShotInformation(whole.shots[:2], whole.information[:2], whole.score[:2], ())
    assert np.isnan(flip_signs(PROBLEM, two, FREE, "air_drag", rng))


def test_gains_by_another_law_that_scatter_about_nothing_are_chance() -> None:
    rng = np.random.default_rng(3)
    p = np.array([flip_gains(rng.standard_t(1.5, SHOTS), 1) for _ in range(300)])
    for level in (0.05, 0.1, 0.3):
        assert (p <= level).mean() <= level + 2 * np.sqrt(level * (1 - level) / len(p))


def test_every_shot_that_gains_from_another_law_speaks_for_it_and_rivals_count() -> None:
    gains = np.arange(1.0, SHOTS + 1)
    assert flip_gains(gains, 1) == pytest.approx(2.0**-SHOTS)
    assert flip_gains(gains, 3) == pytest.approx(3 * 2.0**-SHOTS)
    assert flip_gains(-gains, 3) == 1.0
    assert np.isnan(flip_gains(gains[:2], 1))
