"""The verdict over the state of the gap, what hold-out shots confirm, and the number of shots."""

from __future__ import annotations

from dataclasses import replace

import pytest

from diagnosis.fitting.gap_closure import UNKNOWN_CLOSURE, GapClosure
from diagnosis.selection.unknown_effects import UnknownEvidence
from diagnosis.verdicts.verdict import CandidateEffect, EffectShare, Verdict
from diagnosis.verdicts.verdict_decision import ENOUGH_SHOTS, Decision, decide_verdict

CLOSED = GapClosure(0.3, 0.05, 0.04, 0.99, (0.95, 1.0), True, 0.9)
OPEN = replace(CLOSED, closed=0.0, interval=(-0.1, 0.1), most_probability=0.01)
NOISE = UnknownEvidence(0.5, 1.0, 0.5, 0.9, 0.9, gap="shown")
SYSTEMATIC = UnknownEvidence(1e-9, 5.0, 1e-9, 0.1, 0.1, gap="shown")
PROBABILITIES = {"slope": 0.6, "air_drag": 0.3, "none": 0.05, "unknown": 0.05}


def effect(name: str, p_value: float = 0.01, limit: float = 2.0**-8, group: tuple[str, ...] = ()) -> CandidateEffect:
    return CandidateEffect(name, 0.0, (name, *group), (), p_value, limit)


def decide(
    *effects: CandidateEffect, evidence: UnknownEvidence = NOISE, closure: GapClosure = CLOSED,
    shares: tuple[EffectShare, ...] = (), shots: int = 12, is_refuted: bool = False, is_clear: bool = False,
) -> Decision:  # fmt: skip
    named = {one.effect: one for one in effects}
    return decide_verdict(evidence, named, PROBABILITIES, closure, shares, shots, 3, is_refuted, is_clear)


def test_enough_shots_are_the_fewest_that_can_agree_better_than_chance() -> None:
    assert ENOUGH_SHOTS == 6


@pytest.mark.parametrize(
    ("evidence", "effects", "verdict"),
    [
        (NOISE, (effect("slope"),), "effects"),
        (NOISE, (effect("slope", group=("air_drag",)),), "group"),
        (SYSTEMATIC, (), "unknown"),
        (SYSTEMATIC, (effect("slope"),), "unknown"),
        (replace(SYSTEMATIC, gap="unmeasured"), (), "unknown"),
    ],
)
def test_the_evidence_decides_where_a_gap_shows_or_cannot_show(
    evidence: UnknownEvidence, effects: tuple[CandidateEffect, ...], verdict: Verdict
) -> None:
    decided = decide(*effects, evidence=evidence)
    assert decided.verdict == verdict
    assert decided.named == (frozenset() if verdict in ("none", "unknown") else {"slope"})
    assert not decided.reason


def test_without_a_gap_residuals_make_a_note_and_no_unknown_effect() -> None:
    decided = decide(evidence=replace(SYSTEMATIC, gap="absent"), closure=UNKNOWN_CLOSURE)
    assert decided.verdict == "none"
    assert "filter" in decided.notes[0]
    assert not decide(evidence=replace(NOISE, gap="absent"), closure=UNKNOWN_CLOSURE).notes


@pytest.mark.parametrize(
    ("one", "verdict", "words"),
    [
        pytest.param(effect("slope", 0.01), "effects", "", id="shots agree"),
        pytest.param(effect("slope", 0.2), "undecidable", "do not agree", id="shots differ"),
        pytest.param(effect("slope", 0.0625, 0.0625), "undecidable", "too few shots", id="few shots"),
        pytest.param(effect("cushion_law", float("nan")), "undecidable", "too few shots", id="no strength"),
    ],
)
def test_without_a_gap_an_effect_needs_shots_that_agree(one: CandidateEffect, verdict: Verdict, words: str) -> None:
    decided = decide(one, evidence=replace(NOISE, gap="absent"), closure=UNKNOWN_CLOSURE)
    assert decided.verdict == verdict
    assert words in decided.reason


def test_nothing_is_missing_only_where_hold_out_shots_resolve_no_gap() -> None:
    """A fit may hide what acts between its windows: the verdict was `none` with 54 mm where 2.9 are attainable."""
    assert decide(closure=UNKNOWN_CLOSURE).verdict == "none"
    for gap in ("unmeasured", "shown", "absent"):
        for is_clear in (False, True):
            decided = decide(evidence=replace(NOISE, gap=gap), closure=OPEN, is_clear=is_clear)
            assert decided.verdict == ("unknown" if is_clear and gap != "absent" else "undecidable")
            assert "7.5 times" in decided.reason


@pytest.mark.parametrize(("most", "unknown"), [(0.4, 0.6), (0.01, 0.8)])
def test_what_hold_out_shots_overrule_is_as_probable_as_they_say_and_three_of_them_allow_no_certainty(
    most: float, unknown: float
) -> None:
    closure = replace(CLOSED, closed=0.1, interval=(-0.2, 0.9), most_probability=most)
    for effects in ((), (effect("slope"),)):
        decided = decide(*effects, closure=closure, is_clear=True)
        assert decided.verdict == "unknown"
        shared = decided.share_probabilities(PROBABILITIES)
        assert shared["unknown"] == pytest.approx(unknown)  # at most 4 of 5, as after 3 shots of 3
        assert sum(shared.values()) == pytest.approx(1.0)
        assert shared["slope"] / shared["air_drag"] == pytest.approx(2.0)


def test_nothing_is_called_unknown_that_is_less_likely_than_not() -> None:
    closure = replace(CLOSED, closed=0.1, interval=(-0.2, 0.9), most_probability=0.6)
    for effects in ((), (effect("slope"),)):
        assert decide(*effects, closure=closure, is_clear=True).verdict == "undecidable"


def test_hold_out_shots_withdraw_effects_that_may_close_nothing() -> None:
    unsure = replace(CLOSED, closed=0.5, interval=(-0.2, 0.9), most_probability=0.4)
    assert decide(effect("slope"), closure=unsure).verdict == "undecidable"
    assert "-20 % to 90 %" in decide(effect("slope"), closure=unsure).reason
    explained = replace(SYSTEMATIC, explained_share=0.9)
    assert decide(effect("slope"), evidence=explained, closure=unsure).verdict == "unknown"
    likely = replace(unsure, most_probability=0.7)  # the effect closes most of the gap more probably than not
    assert decide(effect("slope"), evidence=explained, closure=likely).verdict == "undecidable"
    assert decide(effect("slope"), is_refuted=True).verdict == "unknown"


def test_an_effect_without_a_measurable_share_is_not_named_and_gives_its_probability_to_the_others() -> None:
    shares = (EffectShare("slope", 0.98, (0.9, 1.0), 0.98), EffectShare("air_drag", 0.001, (-0.1, 0.1), 0.0, False))
    decided = decide(effect("slope"), effect("air_drag"), shares=shares)
    assert decided.named == {"slope"}
    assert "air drag was fitted beside" in decided.notes[0]
    assert decided.share_probabilities(PROBABILITIES) == PROBABILITIES | {"slope": pytest.approx(0.9), "air_drag": 0.0}
    larger = (shares[0], replace(shares[1], closed=0.03))
    assert decide(effect("slope"), effect("air_drag"), shares=larger).named == {"slope", "air_drag"}


def test_few_shots_name_nothing_improbable_and_say_what_they_cannot_exclude() -> None:
    assert decide(effect("air_drag"), shots=4).verdict == "undecidable"
    assert "30 % only" in decide(effect("air_drag"), shots=4).reason
    assert decide(effect("air_drag"), shots=6).verdict == "effects"
    assert "4 shots" in decide(effect("slope"), shots=4).notes[0]
    assert not decide(effect("slope"), shots=6).notes
