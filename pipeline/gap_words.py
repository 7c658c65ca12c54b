"""A diagnosis in words."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from diagnosis.verdict import Candidate, Report


def gap_sentence(report: Report) -> str:
    """What the simulator lacks."""
    names = {one.effect: " or ".join(plain(name) for name in one.group) for one in report.candidates}
    if report.verdict == "effects":
        return f"Your simulator lacks {' and '.join(plain(name) for name in report.effects)}."
    if report.verdict == "group":
        return f"Your simulator lacks {names[report.candidates[0].effect]}; these shots cannot tell which."
    if report.verdict == "none":
        return "These shots show nothing that your simulator lacks."
    if report.verdict == "unknown":
        return f"Something is there that the library does not hold{_mostly_at(report)}."
    return f"These shots decide nothing: {' '.join(report.notes)}."


def _mostly_at(report: Report) -> str:
    """Where most of it shows; empty where nothing says it."""
    if not report.where:
        return ""
    most = report.where[0]
    grows = f", growing with {most.grows_with}" if most.grows_with else ""
    return f": {most.share:.0%} of it shows at {plain(most.phase)}{grows}"


def closed_sentence(report: Report) -> str:
    """How far the gap shrinks; empty where nothing was held out."""
    gap, told = report.gap, report.gap.closing
    if not gap.windows:
        return "No shot that can be predicted was left over to measure how far the gap shrinks."
    if not math.isfinite(told.before):
        return "Nothing could be predicted on the shots that were left over: they begin too uncertainly, or lie still."
    before, after, floor = (length(value, gap.metric) for value in (told.before, told.after, told.floor))
    if report.verdict == "unknown" and told.after == told.before:
        return (
            f"Predicted {gap.horizon:.2f} s ahead on shots that chose nothing, the simulator is off by {before}, where"
            f" {floor} could be reached; no effect of the library takes that error away."
        )
    if not told.resolved:
        return f"Predicted {gap.horizon:.2f} s ahead, the simulator is off by {before}; of that, {floor} is noise."
    it = "them" if len(report.effects) > 1 else "it"
    return (
        f"Predicted {gap.horizon:.2f} s ahead on shots that chose nothing, adding {it} takes the error from {before} "
        f"to {after} of a possible {floor}: {told.closed:.0%} of the gap closed "
        f"({told.interval[0]:.0%} to {told.interval[1]:.0%})."
    )


def length(value: float, metric: str) -> str:
    """A distance in mm or an angle in mrad."""
    return f"{1000 * value:.3g} {'mrad' if metric.endswith('rad') else 'mm'}"


def plain(name: str) -> str:
    """An effect's name as words."""
    return name.replace("_", " ")


def causes(report: Report) -> tuple[Candidate, ...]:
    """The candidates, sorted; effects that are missing together are one of them, and share its probability."""
    named = [one for one in report.candidates if one.effect in report.effects]
    if len(named) < 2:
        return report.candidates
    names = " and ".join(one.effect for one in named)
    found = tuple(replace(s, name=f"{one.effect} {s.name}") for one in named for s in one.strengths)
    together = Candidate(names, report.probability, (names,), found)
    rest = (one for one in report.candidates if one not in named)
    return tuple(sorted((together, *rest), key=lambda one: one.probability, reverse=True))


def strengths(one: Candidate) -> str:
    """The parameters of a candidate with their errors, as far as they were found."""
    known = [s for s in one.strengths if np.isfinite(s.sigma) and s.sigma > 0]
    return "; ".join(f"{plain(s.name)} = {with_unit(f'{s.value:.3g} ± {s.sigma:.2g}', s.unit)}" for s in known)


def with_unit(number: str, unit: str) -> str:
    """A number with its unit, that of a pure number left out."""
    return number if unit == "1" else f"{number} {unit}"
