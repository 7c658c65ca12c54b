"""A diagnosis in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.fitting.names import LAWS, growing, law, named, parameter, phase
from diagnosis.verdicts.verdict import Candidate, Report, Strength


@dataclass(frozen=True, slots=True)
class Cause:
    """What may be missing, in words: a line of the list."""

    name: str
    probability: float
    strength: str
    """with its error, or that it is not told; empty where none was sought."""
    detectable: str
    """what could have been seen of it; empty where nothing could."""
    rivals: str
    """what these shots cannot tell from it."""


def gap_sentence(report: Report) -> str:
    """What the simulator lacks."""
    if report.verdict == "effects":
        return f"Your simulator lacks {' and '.join(_missing(name, report.forms) for name in report.effects)}."
    if report.verdict == "group":
        rivals = " or ".join(named(name) for name in report.candidates[0].group)
        return f"Your simulator lacks {rivals}; these shots cannot tell which."
    if report.verdict == "none":
        return "These shots show nothing that your simulator lacks."
    if report.verdict == "unknown":
        return f"Something is there that the library does not hold{_mostly_at(report)}."
    return f"These shots decide nothing: {'; '.join(report.notes)}."


def _missing(effect: str, forms: tuple[str, ...]) -> str:
    """What is lacked; of published laws which one fits best."""
    fits = dict(zip(LAWS, forms, strict=False)).get(effect)
    return named(effect) if fits is None else f"{LAWS[effect]} ({law(fits)} fits best)"


def shot_named(shot: int, origins: Mapping[int, str]) -> str:
    """A shot by its number, and by its folder where there are several."""
    return f"shot {shot} ({origins[shot]})" if shot in origins else f"shot {shot}"


def folders_of_shots(origins: Mapping[int, str]) -> str:
    """Which shot lies in which folder, a sentence; empty where all lie in one."""
    if not origins:
        return ""
    return f"Shots by their numbers: {'; '.join(f'{shot} is {name}' for shot, name in sorted(origins.items()))}."


def _mostly_at(report: Report) -> str:
    """Where most of it shows; empty where nothing says it."""
    if not report.where:
        return ""
    most = report.where[0]
    grows = f", growing with {growing(most.grows_with)}" if most.grows_with else ""
    return f": {most.share:.0%} of it shows {phase(most.phase)}{grows}"


def closed_sentence(report: Report) -> str:
    """How far the gap shrinks; empty where nothing was held out."""
    gap, told = report.gap, report.gap.closing
    if not gap.windows:
        return "No shot that can be predicted was left over to measure how far the gap shrinks."
    if not math.isfinite(told.before):
        return "Nothing could be predicted on the shots that were left over: they begin too uncertainly, or lie still."
    before, after, floor = (length(value, gap.metric) for value in (told.before, told.after, told.floor))
    if report.verdict == "unknown" and not told.after < told.before:
        return (
            f"Predicted {gap.horizon:.2f} s ahead on shots that chose nothing, the simulator is off by {before}, where"
            f" {floor} could be reached; no effect of the library takes that error away."
        )
    if not told.floor < told.before:
        return f"Predicted {gap.horizon:.2f} s ahead, the simulator is off by {before}, which is noise."
    if not told.resolved:
        return f"Predicted {gap.horizon:.2f} s ahead, the simulator is off by {before}; of that, {floor} is noise."
    it = "adding them" if len(report.effects) > 1 else "adding it"
    it = "what comes nearest" if report.verdict == "unknown" else it
    return (
        f"Predicted {gap.horizon:.2f} s ahead on shots that chose nothing, {it} takes the error from {before} "
        f"to {after} of a possible {floor}: {told.closed:.0%} of the gap closed "
        f"({told.interval[0]:.0%} to {told.interval[1]:.0%})."
    )


def length(value: float, metric: str) -> str:
    """A distance in mm or an angle in mrad."""
    return f"{1000 * value:.3g} {'mrad' if metric.endswith('rad') else 'mm'}"


def causes(report: Report) -> tuple[Cause, ...]:
    """The list of causes, likeliest first; effects that are missing together are one, and share its probability."""
    together = [one for one in report.candidates if one.effect in report.effects]
    if len(together) < 2:
        return tuple(_cause(one) for one in report.candidates)
    parts = [_cause(one) for one in together]
    whole = Cause(
        name=" and ".join(one.name for one in parts),
        probability=report.probability,
        strength="; ".join(f"{one.name} {one.strength}" for one in parts if one.strength),
        detectable="; ".join(f"{one.name} {one.detectable}" for one in parts if one.detectable),
        rivals=", ".join(one.rivals for one in parts if one.rivals),
    )
    rest = (_cause(one) for one in report.candidates if one not in together)
    return tuple(sorted((whole, *rest), key=lambda one: one.probability, reverse=True))


def _cause(one: Candidate) -> Cause:
    told = (strength(s) for s in one.strengths)
    seen = (f"{parameter(s.name)} {_detectable(s)}" for s in one.strengths if math.isfinite(s.detectable_from))
    rivals = (named(name) for name in one.group[1:])
    return Cause(named(one.effect), one.probability, "; ".join(filter(None, told)), "; ".join(seen), ", ".join(rivals))


def strength(one: Strength) -> str:
    """A parameter with its error, or that these shots do not tell it; empty where it was not fitted."""
    if not (math.isfinite(one.sigma) and one.sigma > 0):
        return ""
    if one.prior_only:
        return f"{parameter(one.name)}: {untold(one)}"
    return f"{parameter(one.name)} = {with_unit(f'{one.value:.3g} ± {one.sigma:.2g}', one.unit)}"


def untold(one: Strength) -> str:
    """What can be said of a parameter that is only what was known beforehand."""
    if not math.isfinite(one.detectable_from):
        return "these shots do not tell it"
    return f"these shots do not tell it, they would show {_detectable(one)} or more"


def _detectable(one: Strength) -> str:
    return with_unit(f"{one.detectable_from:.2g}", one.unit)


def undecided(report: Report) -> str:
    """What no shot can tell, what these shots would have missed, and what they gave no way to test, as sentences."""
    weighed = {one.effect for one in report.candidates}
    never = [named(name) for name in report.unidentifiable if name not in weighed]
    missed = [named(name) for name in report.unidentifiable if name in weighed]
    untested = [named(name) for name in report.not_tested]
    lists = ("No shot can tell", never), ("These shots would have missed at usual strength", missed)
    return " ".join(f"{what}: {', '.join(which)}." for what, which in (*lists, ("Not tested", untested)) if which)


def with_unit(number: str, unit: str) -> str:
    """A number with its unit, that of a pure number left out."""
    return number if unit == "1" else f"{number} {unit}"
