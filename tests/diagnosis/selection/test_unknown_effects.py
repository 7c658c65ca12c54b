"""A law that the library lacks is unknown; a law whose strength differs from shot to shot is named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from support.reference_frames import PLANE

from diagnosis.diagnose import diagnose
from diagnosis.fitting.gap_closure import UNKNOWN_CLOSURE, GapClosure
from diagnosis.fitting.hypothesis_fits import COARSE_FIT, EffectFit, build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.selection.study import judge_by_generic_laws
from diagnosis.selection.unknown_effects import SUSPICIOUS_P_VALUE, UnknownEvidence, min_selection_gain
from diagnosis.verdicts.candidate_probabilities import put_answer_first
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.gap_scene import neutral_values

NOISE = 0.003
"""m"""
FLIGHT = build_flight_scene(2)
NAMES = [f"{effect.name}.{prior.name}" for effect in FLIGHT.effects for prior in effect.parameters]
ROWS = 30
"""rows, at 30 frames per second"""


def throws(strength: str, values: np.ndarray, seed: int = 0) -> tuple[Recording, ...]:
    """Simulate one throw per value of a parameter."""
    rng = np.random.default_rng(seed)
    recordings = []
    for shot, value in enumerate(values):
        shared = neutral_values(FLIGHT)
        shared[NAMES.index(strength)] = value
        speed, angle = rng.uniform(6, 12), np.radians(rng.uniform(35, 80))
        blank = Recording(
            shot,
            np.arange(ROWS),
            np.arange(ROWS) / 30,
            ("ball",),
            np.zeros((ROWS, 1, 2)),
            np.full((ROWS, 1), NOISE),
            PLANE,
        )
        path = FLIGHT.predict_positions(
            blank, np.array([0, 1, speed * np.cos(angle), speed * np.sin(angle)]), shared, ()
        )
        recordings.append(replace(blank, positions=path + NOISE * rng.standard_normal(path.shape)))
    return tuple(recordings)


@cache
def diagnose_equal_throws(strength: str, value: float) -> DiagnosisReport:
    """Diagnose eight throws of equal strength."""
    return diagnose(FLIGHT, throws(strength, np.full(8, value)))


def test_a_drag_that_differs_from_shot_to_shot_is_still_named() -> None:
    report = diagnose(FLIGHT, throws("air_drag.k", np.random.default_rng(1).uniform(0.16, 0.24, 8)))
    assert report.effects == ("air_drag",)
    assert 0.01 < report.candidates[0].strengths[0].shot_spread < 0.05
    assert diagnose_equal_throws("air_drag.k", 0.2).candidates[0].strengths[0].shot_spread == 0.0


def test_a_drag_of_a_law_that_the_library_lacks_is_unknown() -> None:
    """A brake that falls with speed is neither of the two drags."""
    report = diagnose_equal_throws("brake_over_speed.c0", 2.0)
    assert report.verdict == "unknown"
    assert report.per_effect, "the best effect of the library is measured too"


def test_the_floor_follows_from_the_noise_whatever_the_model_leaves() -> None:
    """A brake that no effect of the library explains: the floor is that of the true law."""
    wrong = diagnose_equal_throws("brake_over_speed.c0", 2.0).gap.closure
    right = diagnose_equal_throws("air_drag.k", 0.2).gap.closure
    assert wrong.after > 1.5 * wrong.floor
    assert wrong.floor < 2 * right.floor


def test_a_floor_needs_a_known_noise() -> None:
    """Flights of 18 frames have no stretch from which their noise could be measured."""
    short = tuple(one.select_rows(0, 18) for one in throws("air_drag.k", np.full(8, 0.2)))
    assert np.isfinite(diagnose(FLIGHT, short).gap.closure.floor)
    unstated = diagnose(FLIGHT, tuple(replace(one, is_sigma_stated=False) for one in short))
    assert np.isnan(unstated.gap.closure.floor)
    assert not unstated.gap.closure.resolved
    assert unstated.gap.floor_reason.startswith("the noise is unknown")


def test_a_weak_drag_is_named_or_grouped_with_its_twin() -> None:
    """Six standard deviations."""
    report = diagnose(FLIGHT, throws("air_drag.k", np.full(12, 0.0025)))
    assert report.verdict in ("effects", "group")
    assert "air_drag" in report.candidates[0].group


def test_what_is_named_comes_first_though_each_of_two_twins_is_less_likely_than_nothing() -> None:
    chances = {"none": 0.36, "air_drag": 0.34, "viscous_drag": 0.3}
    assert put_answer_first(chances, frozenset({"air_drag"})) == {"none": 0.34, "air_drag": 0.36, "viscous_drag": 0.3}
    assert put_answer_first(chances | {"none": 0.1}, frozenset({"air_drag"})) == chances | {"none": 0.1}


@pytest.mark.parametrize(
    ("explained", "lawful", "missing"),
    [
        (0.4, float("nan"), True),
        (0.6, float("nan"), False),
        (0.6, 0.0, False),
        (0.95, 0.6, False),
        (0.95, 0.9, True),
        (0.999, 0.9, False),
    ],
)
def test_effects_are_named_where_they_explain_most_and_no_generic_law_does_far_better(
    explained: float, lawful: float, missing: bool
) -> None:
    evidence = UnknownEvidence(1e-9, 1.0, 1.0, explained, explained, True, lawful)
    assert evidence.is_unknown is missing
    assert (evidence.probability >= 0.49) is missing


def test_an_effect_that_surely_explains_most_leaves_little_doubt() -> None:
    """Residuals are never noise on real tables; that alone must not speak against a named effect."""
    chances = [UnknownEvidence(1e-12, 1.0, 1.0, 0.99, most, True, 0.0).probability for most in (0.6, 0.9, 0.99)]
    assert chances == sorted(chances, reverse=True)
    assert chances[-1] < 0.02


def test_several_effects_are_less_sure_than_one_as_together_they_imitate_others() -> None:
    """Gravity, spring and sensor scale, named for a force that was none of them, had a probability of 0.95."""
    evidence = UnknownEvidence(0.5, 1.0, 0.5, 0.996, 0.5)
    unknown = [replace(evidence, effect_count=count).probability for count in (1, 2, 3)]
    np.testing.assert_allclose(unknown, [0.05 / 1.1, 0.1 / 1.2, 0.2 / 1.4])
    assert not replace(evidence, effect_count=3).is_unknown


def test_several_effects_are_no_answer_where_one_generic_law_alone_explains_what_they_leave() -> None:
    """Gravity, spring and sensor scale close 98 % of the gap of a force that varies with the angle of a joint."""
    imitated = UnknownEvidence(1e-9, 5.0, 1e-9, 0.9998, 0.95, effect_count=3)
    assert not imitated.is_unknown
    unknown = replace(imitated, imitation_probability=0.75).judge_by_predictions(CLOSED)
    assert unknown.is_unknown
    assert unknown.probability == pytest.approx(0.75, abs=0.01)
    noise = replace(imitated, residual_p_value=0.5, residual_scale=1.0, agreement_p_value=0.5)
    assert not replace(noise, imitation_probability=0.75).is_unknown


def judge_drags(costs: list[tuple[float, float]], monkeypatch: pytest.MonkeyPatch, names: int = 2) -> UnknownEvidence:
    """Judge named drags whose costs of selection shots are given: those that they leave, and those of generic laws."""
    shots = throws("air_drag.k", np.full(len(costs), 0.2))
    problem = build_diagnosis_problem(FLIGHT, WHITE_NOISE)
    before = fit_effects(problem, shots, (), options=COARSE_FIT)
    after = replace(before, names=("air_drag", "viscous_drag")[:names])

    def fit_start_states(_: object, segments: tuple[Recording, ...], like: EffectFit, *__: object) -> object:
        excess = [costs[one.shot]["brake_over_speed" in like.names] for one in segments]
        return SimpleNamespace(cost=sum(excess), systematic_cost=sum(excess))

    monkeypatch.setattr("diagnosis.selection.study.fit_start_states", fit_start_states)
    monkeypatch.setattr(
        "diagnosis.selection.study.fit_effects",
        lambda problem, segments, names, *_: replace(before, names=names),
    )
    evidence = UnknownEvidence(1e-9, 5.0, 1e-9, 0.99, 0.9, effect_count=names)
    return judge_by_generic_laws(problem, evidence, after, shots, before, after)


def test_generic_laws_alone_unmask_an_imitation_where_they_explain_most_shots_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    better = judge_drags([(1000.0, 10.0), (50.0, 40.0), (50.0, 60.0)], monkeypatch)
    assert better.imitation_probability == pytest.approx(3 / 5)
    assert better.is_unknown
    few = judge_drags([(1000.0, 10.0), (50.0, 60.0)], monkeypatch)
    assert few.imitation_probability == 0
    assert few.generic_law_share == pytest.approx(980 / 1050)
    assert judge_drags([(10.0, 9.0)] * 3, monkeypatch).imitation_probability == 0, "they explain little"
    assert judge_drags([(1000.0, 10.0)] * 3, monkeypatch, names=1).imitation_probability == 0, "one effect is a law"


def test_shots_that_lose_from_an_effect_speak_for_another_one() -> None:
    assert UnknownEvidence(0.5, 1.0, 0.5, 0.99, 0.9, False, 0.0).is_unknown
    assert UnknownEvidence(0.5, 1.0, 0.5, 0.99, 0.9, False, 0.0).probability > 0.25


def test_residuals_far_larger_than_the_noise_are_no_noise_whatever_their_structure() -> None:
    """Heights that a filter lets swing by metres have no structure by speed, place or shot."""
    assert UnknownEvidence(0.3, 8.0, 1.0, 0.0, 0.0, True, float("nan")).is_unknown
    assert not UnknownEvidence(0.3, 1.3, 1.0, 0.0, 0.0, True, float("nan")).is_unknown


@pytest.mark.parametrize("strength", [0.5, 2.0, 3.5, 8.0])
def test_shots_that_confirm_contradict_no_oftener_than_chance_allows(strength: float) -> None:
    """An effect of any strength, estimated from six shots and tested on three equal ones."""
    rng = np.random.default_rng(0)
    estimates = strength + np.sqrt(3 / 6) * rng.standard_normal(400_000)
    tests = strength + rng.standard_normal(400_000)
    gains = tests**2 - (tests - estimates) ** 2
    assert (gains < min_selection_gain(6, 3)).mean() < SUSPICIOUS_P_VALUE


def test_shots_that_lose_by_much_contradict() -> None:
    assert -20.0 < min_selection_gain(6, 3) < min_selection_gain(9, 3) < -4.0


CLOSED = GapClosure(0.3, 0.05, 0.01, 0.975, (0.95, 0.99), True, 0.9)


def test_residuals_are_no_evidence_where_other_shots_are_predicted_as_well_as_noise_allows() -> None:
    """Noise that a filter left is correlated over many samples, so that residuals are not white."""
    evidence = UnknownEvidence(1e-9, 5.0, 1e-9)
    assert evidence.is_unknown
    assert evidence.judge_by_predictions(UNKNOWN_CLOSURE).gap == "unmeasured"
    assert evidence.judge_by_predictions(replace(UNKNOWN_CLOSURE, is_absent=True)).gap == "absent"
    assert evidence.judge_by_predictions(CLOSED).gap == "shown"
    assert evidence.supported.is_unknown
    assert not replace(evidence, gap="absent").supported.is_unknown
    assert replace(evidence, gap="absent").supported.probability < 0.1


def test_effects_that_close_nearly_all_of_the_gap_are_the_answer_unless_their_law_has_another_form() -> None:
    contradicted = UnknownEvidence(1e-9, 5.0, 1e-9, 0.98, 0.9, False)
    assert contradicted.is_unknown
    assert not contradicted.judge_by_predictions(CLOSED).is_unknown
    assert contradicted.judge_by_predictions(replace(CLOSED, closed=0.85)).is_unknown
    assert contradicted.judge_by_predictions(replace(CLOSED, interval=(-0.1, 0.99))).is_unknown
    assert replace(contradicted, generic_law_share=0.8).judge_by_predictions(CLOSED).is_unknown
    assert contradicted.judge_by_predictions(CLOSED).rest_probability > 0.99


def test_effects_that_may_close_less_than_half_of_the_gap_are_no_answer_where_more_than_noise_remains() -> None:
    confirmed = UnknownEvidence(1e-9, 5.0, 1e-9, 0.8, 0.9)
    assert not confirmed.judge_by_predictions(replace(CLOSED, closed=0.75, interval=(0.6, 0.9))).is_unknown
    assert confirmed.judge_by_predictions(replace(CLOSED, closed=0.75, interval=(0.3, 0.9))).is_unknown
    noise = UnknownEvidence(0.5, 1.0, 0.5, 0.8, 0.9)
    assert not noise.judge_by_predictions(replace(CLOSED, closed=0.75, interval=(0.3, 0.9))).is_unknown
