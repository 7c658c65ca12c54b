"""Strengths of an effect that has one for each of many joints."""

from __future__ import annotations

from diagnosis.verdicts.verdict import CandidateEffect, Strength
from pipeline.reporting.text.gap_sentences import _build_cause

INF = float("inf")


def write_strengths(effect: str, *strengths: Strength) -> str:
    return _build_cause(CandidateEffect(effect, 0.9, (effect,), strengths), "mechanism").strength


def test_many_joints_have_their_least_and_greatest_strength_by_unit():
    turns = [
        Strength(f"dry_{name}", "N m", value, 0.01, INF)
        for name, value in zip("abcde", (0.5, 0.2, 0.9, 0.3, 0.4), strict=True)
    ]
    line = Strength("dry_rail", "N", 4.0, 0.1, INF)
    hidden = Strength("dry_hidden", "N m", 0.0, 0.5, INF, prior_only=True)
    assert write_strengths("joint_friction", *turns, line, hidden) == (
        "dry of 5 joints = 0.200 ± 0.010 (b) to 0.900 ± 0.010 (c), N m; dry of 1 joint = 4.00 ± 0.10 (rail), N;"
        " dry of 1 joint: not identifiable"
    )


def test_what_was_not_fitted_is_not_said_to_be_zero():
    assert write_strengths("delay", *(Strength(f"time_{k}", "s", 0.0, INF, INF) for k in range(8))) == ""


def test_few_strengths_are_listed_one_by_one():
    assert write_strengths("delay", Strength("time", "s", 0.02, 0.001, INF)) == "time = 0.0200 ± 0.0010 s"
