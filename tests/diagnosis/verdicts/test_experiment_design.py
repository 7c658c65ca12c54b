"""The recommended experiment is computed, and filming it has the announced result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.fit_residuals import FitResiduals, compute_residuals
from diagnosis.fitting.hypothesis_fits import (
    DiagnosisProblem,
    EffectFit,
    LinearizedFit,
    build_diagnosis_problem,
    fit_effects,
    linearize_fit,
)
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.selection.hypotheses import compute_signatures
from diagnosis.verdicts.gap_localisation import design_detecting_experiment, design_unknown_experiment, localise_gap
from models.core.recording import Recording

FRICTION = {"friction.mu": 0.02}


@pytest.fixture(scope="module")
def shots() -> tuple[Recording, ...]:
    return film(np.random.default_rng(3), FRICTION, Filming(shots=4, fps=30))


@pytest.fixture(scope="module")
def problem() -> DiagnosisProblem:
    return build_diagnosis_problem(Pucks(), WHITE_NOISE)


@pytest.fixture(scope="module")
def base_fit(problem: DiagnosisProblem, shots: tuple[Recording, ...]) -> tuple[EffectFit, LinearizedFit, FitResiduals]:
    fit = fit_effects(problem, shots)
    linearized = linearize_fit(problem, fit)
    return fit, linearized, compute_residuals(problem, fit, linearized, np.random.default_rng(0))


def test_what_would_be_seen_needs_no_more_film(
    problem: DiagnosisProblem, base_fit: tuple[EffectFit, LinearizedFit, FitResiduals]
) -> None:
    fit, linearized, residuals = base_fit
    plenty = np.full(len(problem.priors), 1e6)
    assert (
        design_detecting_experiment(
            problem, linearized.shot_information, residuals, fit.free, plenty, ("slope", "air_drag"), 1.0
        )
        == ""
    )


def test_the_shots_that_are_asked_for_show_the_effect(
    problem: DiagnosisProblem, base_fit: tuple[EffectFit, LinearizedFit, FitResiduals]
) -> None:
    fit, linearized, residuals = base_fit
    usual = 0.7 * _smallest_strengths(problem, fit, linearized)
    sentence = design_detecting_experiment(
        problem, linearized.shot_information, residuals, fit.free, usual, ("air_drag",), 1.0
    )
    assert sentence.startswith("This answer stands as it is."), "the sentence states that these recordings are optional"
    words = sentence.split()
    more, shot = int(words[words.index("more", words.index("record")) - 1]), int(words[words.index("shot") + 1])
    number = [segment.shot for segment in fit.segments].index(shot)
    copies = tuple(replace(fit.segments[number], shot=100 + k) for k in range(more))
    with_them = fit_effects(problem, (*fit.segments, *copies), guess=fit.shared)
    mask = problem.mask(("air_drag",))
    assert np.all(
        _smallest_strengths(problem, with_them, linearize_fit(problem, with_them))[mask] <= 1.01 * usual[mask]
    )


def test_what_no_number_of_such_shots_can_show_needs_other_shots(
    problem: DiagnosisProblem, base_fit: tuple[EffectFit, LinearizedFit, FitResiduals]
) -> None:
    fit, linearized, residuals = base_fit
    tiny = np.full(len(problem.priors), 1e-9)
    sentence = design_detecting_experiment(
        problem, linearized.shot_information, residuals, fit.free, tiny, ("air_drag",), 1.0
    )
    assert "To look for air drag of usual strength too, record much slower and much faster motion" in sentence
    assert "more shots like these would not reveal it" in sentence


def test_what_is_left_is_sought_in_the_shot_that_has_it(
    problem: DiagnosisProblem, shots: tuple[Recording, ...]
) -> None:
    bent = shots[2].positions.copy()
    bent[:, 0] += 0.02 * np.sin(6 * shots[2].t)[:, None]
    fit = fit_effects(problem, (*shots[:2], replace(shots[2], positions=bent), shots[3]))
    residuals = compute_residuals(problem, fit, linearize_fit(problem, fit), np.random.default_rng(0))
    sentence = design_unknown_experiment(problem, residuals)
    assert f"in shot {shots[2].shot} " in sentence
    assert "from the surroundings or the camera" in sentence, "pucks have no table"


def test_a_ball_is_named_as_its_own_film_names_it(problem: DiagnosisProblem, shots: tuple[Recording, ...]) -> None:
    many = tuple(replace(one, bodies=tuple(f"{one.shot}.{k}" for k in range(len(one.bodies)))) for one in shots)
    fit = fit_effects(problem, many)
    residuals = compute_residuals(problem, fit, linearize_fit(problem, fit), np.random.default_rng(0))
    its_own = (residuals.shot == many[2].shot) & (residuals.body == 0)
    odd = replace(residuals, values=np.where(its_own[:, None], 5.0 / residuals.scale, residuals.values))
    assert {place.ball for place in localise_gap(odd, many, frozenset())} == {many[2].bodies[0]}


def _smallest_strengths(problem: DiagnosisProblem, fit: EffectFit, linearized: LinearizedFit) -> np.ndarray:
    """(P,) smallest strengths that show."""
    mask = problem.mask(("air_drag",))
    strengths = compute_signatures(problem, linearized.shot_information, fit.free & ~mask, 1.0).detectable_strengths(
        mask
    )
    return np.where(np.isfinite(strengths), strengths, 1.0)


def test_a_limit_of_inputs_is_shown_by_larger_inputs_and_not_by_more_of_the_same(
    base_fit: tuple[EffectFit, LinearizedFit, FitResiduals],
) -> None:
    fit, linearized, residuals = base_fit
    catalogue = tuple(replace(one, name="saturation") if one.name == "air_drag" else one for one in Pucks().effects)
    problem = build_diagnosis_problem(Pucks(effects=catalogue), WHITE_NOISE)
    tiny = np.full(len(problem.priors), 1e-9)
    sentence = design_detecting_experiment(
        problem, linearized.shot_information, residuals, fit.free, tiny, ("saturation",), 1.0
    )
    assert "record larger inputs" in sentence
