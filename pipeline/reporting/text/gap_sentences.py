"""Sentences about a diagnosis of the sim-to-real gap."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.fitting.display_names import (
    LAWS,
    format_cause,
    format_growth_variable,
    format_law,
    format_parameter,
    format_phase,
)
from diagnosis.unexplained.force_law import ForceLaw
from diagnosis.unexplained.local_patch import LocalPatch
from diagnosis.verdicts.verdict import CandidateEffect, DiagnosisReport, Strength
from pipeline.reporting.text.number_format import format_unit, format_value, format_with_sigma

MANY_TIMES = 3.0
"""Ratio of the remaining error to the noise from which the first sentence states it: noise is then a tenth of it."""
_VARIABLES = {
    "speed": "speed",
    "time": "the time in the shot",
    "x": "place along x",
    "y": "place along y",
    "z": "height",
}
"""Quantities with which a force varies, as sentences name them."""


@dataclass(frozen=True, slots=True)
class Cause:
    """One line of the list of candidate effects, as text."""

    name: str
    probability: float
    strength: str
    """Fitted parameters with their standard deviations; empty if none were fitted."""
    detectable: str
    """Smallest detectable parameter values; empty if none."""
    rivals: str
    """Effects that these shots cannot distinguish from it."""


def format_verdict(report: DiagnosisReport) -> str:
    """Format the verdict: which effects the simulator lacks.

    Args:
        report: Result of a diagnosis.

    Returns:
        One sentence.
    """
    if report.verdict == "effects":
        missing = " and ".join(_format_missing_effect(name, report.forms) for name in report.effects)
        return f"Your simulator lacks {missing}{_format_large_rest(report)}."
    if report.verdict == "group":
        rivals = " or ".join(format_cause(name) for name in report.candidates[0].group)
        return (
            f"Your simulator lacks {rivals} (these shots cannot distinguish between them){_format_large_rest(report)}."
        )
    if report.verdict == "none":
        return "These shots show no effect that your simulator lacks."
    if report.verdict == "unknown":
        return (
            f"Your simulator lacks an effect that trueroll does not know{_format_main_place(report)}"
            f"{_format_best_share(report)}."
        )
    return f"These shots do not allow a verdict: {'; '.join(report.notes)}."


def format_agreement(report: DiagnosisReport) -> tuple[str, ...]:
    """Format how improbable it is that shots without a missing effect agree about the named ones as these do.

    Args:
        report: Result of a diagnosis.

    Returns:
        One sentence per named effect that could be tested; with a group, about its first name.
    """
    named = report.effects or tuple(one.effect for one in report.candidates[:1] if report.verdict == "group")
    return tuple(
        f"{format_cause(one.effect).capitalize()}: shots without a missing effect would agree about one as well in at"
        f" most {format_share(one.sign_flip_p_value)} of all cases, whatever the noise within a shot is (the signs of"
        " whole shots were flipped)."
        for one in report.candidates
        if one.effect in named and math.isfinite(one.sign_flip_p_value)
    )


def format_body_differences(report: DiagnosisReport) -> tuple[str, ...]:
    """Format the strengths of each body, where they differ between bodies.

    Args:
        report: Result of a diagnosis.

    Returns:
        One sentence per parameter that differs.
    """
    sentences = []
    for candidate in report.candidates:
        for common in (one for one in candidate.strengths if one.body_spread > 0):
            own = [
                f"{body.body} {format_with_sigma(one.value, one.sigma)}"
                for body in candidate.per_body
                for one in body.strengths
                if one.name == common.name
            ]
            unit = f" in {format_unit(common.unit)}" if common.unit != "1" else ""
            sentences.append(
                f"The strength of {format_cause(candidate.effect)} differs between bodies,"
                f" {format_parameter(common.name)}{unit}: {', '.join(own)}. It scatters by"
                f" {format_with_unit(format_value(common.body_spread, 2), common.unit)} between them; predictions use"
                " the strength of each body."
            )
    return tuple(sentences)


def _format_large_rest(report: DiagnosisReport) -> str:
    """Format that the error that remains is many times the noise; empty where it is not."""
    rest, closed = report.unexplained, report.gap.closure.closed
    if not rest.times_floor >= MANY_TIMES or not math.isfinite(closed):
        return ""
    closing = "close" if len(report.effects) > 1 else "closes"
    return (
        f", which {closing} {format_share(closed)} of the gap; the error that remains is"
        f" {format_value(rest.times_floor, 2)} times what measurement noise explains"
    )


def _format_best_share(report: DiagnosisReport) -> str:
    """Format what the best effects of the library would close of the gap; empty where it was not measured."""
    if not report.per_effect:
        return ""
    names = " and ".join(format_cause(one.effect) for one in report.per_effect)
    closed = sum(one.closed for one in report.per_effect)
    return f"; the best that it knows, {names}, would close {format_share(max(closed, 0.0))} of it"


def format_share(share: float) -> str:
    """Format a share in per cent; nearly all or nearly nothing with a decimal.

    Args:
        share: Between 0 and 1.

    Returns:
        The share, such as 61 % or 99.4 %.
    """
    return f"{100 * share:.1f} %" if 0.95 < share < 0.9995 or 0.0005 < abs(share) < 0.05 else f"{100 * share:.0f} %"


def format_unexplained(report: DiagnosisReport) -> tuple[str, ...]:
    """Format what remains of the gap after the named effects: how much, where, and what is known of its cause.

    Args:
        report: Result of a diagnosis.

    Returns:
        Sentences; none where nothing beyond noise remains.
    """
    rest, metric = report.unexplained, report.gap.metric
    if not rest.where:
        return ()
    sentences = []
    first = rest.where[0]
    place = f"most of it appears {format_phase(first.phase)}" if len(rest.where) > 1 else ""
    grows = f"it grows with {format_growth_variable(first.grows_with)}" if first.grows_with else ""
    details = "".join(f"; {one}" for one in (place, grows) if one)
    if math.isfinite(rest.share) and rest.size > 0:
        sentences.append(
            f"{format_share(rest.share)} of the gap remains: an error of {format_error_size(rest.size, metric)} beyond"
            f" the attainable one, which no effect that trueroll knows explains{details}."
        )
    else:
        sentences.append(f"What remains is more than noise{details}.")
    if rest.law is not None:
        sentences.append(_format_law_sentence(rest.law, metric))
    if rest.patch is not None:
        sentences.append(_format_patch_sentence(rest.patch))
    named = {
        one.effect: one for one in report.candidates if one.effect in {share.effect for share in report.per_effect}
    }
    sentences += [
        f"The strength of {format_cause(name)} differs between shots:"
        f" {format_parameter(s.name)} scatters by {format_with_unit(format_value(s.shot_spread, 2), s.unit)}."
        for name, one in named.items()
        for s in one.strengths
        if s.shot_spread > 0
    ]
    return tuple(sentences)


def _format_law_sentence(law: ForceLaw, metric: str) -> str:
    """Format the direction of an unexplained force, what it varies with, and its nearest formula."""
    unit = "rad" if metric.endswith("rad") else "m"
    units = {"speed": f"{unit}/s", "time": "s"}
    direction = f"{law.direction} the motion" if law.direction in ("along", "across") else f"along {law.direction}"
    formula = (
        f": {law.formula}, with a in {unit}/s² and u the {law.variable} in {units.get(law.variable, unit)}"
        if law.formula
        else ", by no short formula"
    )
    return (
        f"It acts like an acceleration {direction} that varies with {_VARIABLES.get(law.variable, law.variable)}"
        f"{formula}; on other shots this explains {format_share(min(law.explained, 1.0))} of the unexplained"
        " acceleration."
    )


def _format_patch_sentence(patch: LocalPatch) -> str:
    """Format place, size and strength of a patch."""
    kind = "slowed" if patch.strength < 0 else "sped up"
    return (
        f"Within {format_with_sigma(1000 * patch.radius, 1000 * patch.radius_sigma, 0)} mm of ({patch.centre[0]:.2f},"
        f" {patch.centre[1]:.2f}) m, bodies are {kind} by"
        f" {format_with_sigma(abs(patch.strength), patch.strength_sigma)} m/s² more than elsewhere"
        f" (p-value {format_p_value(patch.p_value)})."
    )


def _format_missing_effect(effect: str, forms: tuple[str, ...]) -> str:
    """Format a missing effect; for a contact model, name the published model that fits best."""
    fits = dict(zip(LAWS, forms, strict=False)).get(effect)
    return format_cause(effect) if fits is None else f"{LAWS[effect]} ({format_law(fits)} fits best)"


def format_shot_name(shot: int, origins: Mapping[int, str]) -> str:
    """Format the name of a shot.

    Args:
        shot: Its number.
        origins: Folder names of the shots; empty if all are in one folder.

    Returns:
        The number, with the folder if it is known.
    """
    return f"shot {shot} ({origins[shot]})" if shot in origins else f"shot {shot}"


def format_shot_folders(origins: Mapping[int, str]) -> str:
    """Format which shot comes from which folder.

    Args:
        origins: Folder names of the shots.

    Returns:
        One sentence; empty if all shots are in one folder.
    """
    if not origins:
        return ""
    return f"Shot numbers: {'; '.join(f'{shot} is {name}' for shot, name in sorted(origins.items()))}."


def _format_main_place(report: DiagnosisReport) -> str:
    """Format where most of the gap is; empty if it is not localised."""
    if not report.where:
        return ""
    most = report.where[0]
    grows = f", growing with {format_growth_variable(most.grows_with)}" if most.grows_with else ""
    return f": {format_share(most.share)} of the gap appears {format_phase(most.phase)}{grows}"


def format_gap_closure(report: DiagnosisReport) -> str:
    """Format how much of the prediction error on hold-out shots the missing effects explain.

    Args:
        report: Result of a diagnosis.

    Returns:
        One sentence with the errors before and after, and the share of the gap that is closed.
    """
    gap, closing = report.gap, report.gap.closure
    if not gap.windows:
        return "No hold-out shot that can be predicted is left to measure how much the gap shrinks."
    if not math.isfinite(closing.before):
        return "No hold-out shot could be predicted: its initial state is too uncertain, or nothing moves."
    before, after, floor = (
        format_error_size(value, gap.metric) for value in (closing.before, closing.after, closing.floor)
    )
    if gap.floor_reason:
        return (
            f"On hold-out shots, predicted {gap.horizon:.2f} s ahead, the error goes from {before} to {after}; how much"
            f" of that is attainable is unknown, because {gap.floor_reason}."
        )
    if report.verdict == "unknown" and not closing.after < closing.before:
        return (
            f"On hold-out shots, predicted {gap.horizon:.2f} s ahead, the simulator has an error of {before}"
            f" (attainable: {floor}); no effect that trueroll knows reduces it."
        )
    if not closing.floor < closing.before:
        return f"Predicted {gap.horizon:.2f} s ahead, the simulator has an error of {before}, which is noise."
    if not closing.resolved:
        return (
            f"Predicted {gap.horizon:.2f} s ahead, the simulator has an error of {before}, of which {floor} is noise."
        )
    change = "adding them" if len(report.effects) > 1 else "adding it"
    change = "the most similar effect" if report.verdict == "unknown" else change
    return (
        f"On hold-out shots, predicted {gap.horizon:.2f} s ahead, {change} reduces the error from {before} "
        f"to {after} (attainable: {floor}): {format_share(closing.closed)} of the gap closed "
        f"(95 % interval: {format_share(closing.interval[0])} to {format_share(closing.interval[1])})."
    )


def format_error_size(value: float, metric: str) -> str:
    """Format a prediction error with its unit.

    Args:
        value: Error in m or rad.
        metric: Name of the metric; it ends in "rad" for angles.

    Returns:
        A distance in mm or an angle in mrad.
    """
    return f"{format_value(1000 * value)} {'mrad' if metric.endswith('rad') else 'mm'}"


def list_causes(report: DiagnosisReport) -> tuple[Cause, ...]:
    """List the candidate effects by decreasing probability.

    Args:
        report: Result of a diagnosis.

    Returns:
        The candidates; effects that are missing together form one candidate with their joint probability.
    """
    together = [one for one in report.candidates if one.effect in report.effects]
    if len(together) < 2:
        return tuple(_build_cause(one) for one in report.candidates)
    parts = [_build_cause(one) for one in together]
    whole = Cause(
        name=" and ".join(one.name for one in parts),
        probability=report.probability,
        strength="; ".join(f"{one.name} {one.strength}" for one in parts if one.strength),
        detectable="; ".join(f"{one.name} {one.detectable}" for one in parts if one.detectable),
        rivals=", ".join(one.rivals for one in parts if one.rivals),
    )
    rest = (_build_cause(one) for one in report.candidates if one not in together)
    return tuple(sorted((whole, *rest), key=lambda one: one.probability, reverse=True))


def _build_cause(one: CandidateEffect) -> Cause:
    strengths = (format_strength(s) for s in one.strengths)
    detectable = (
        f"{format_parameter(s.name)} {_format_detectable(s)}" for s in one.strengths if math.isfinite(s.detectable_from)
    )
    rivals = (format_cause(name) for name in one.group[1:])
    return Cause(
        format_cause(one.effect),
        one.probability,
        "; ".join(filter(None, strengths)),
        "; ".join(detectable),
        ", ".join(rivals),
    )


def format_strength(one: Strength) -> str:
    """Format a parameter with its standard deviation, or that it is not identifiable; empty if it was not fitted."""
    if not (math.isfinite(one.sigma) and one.sigma > 0):
        return ""
    if one.prior_only:
        return f"{format_parameter(one.name)}: {format_unidentified(one)}"
    return f"{format_parameter(one.name)} = {format_with_unit(format_with_sigma(one.value, one.sigma), one.unit)}"


def format_unidentified(one: Strength) -> str:
    """Format that a parameter was determined by its prior alone.

    Args:
        one: The parameter.

    Returns:
        A phrase with the smallest detectable value, if there is one.
    """
    if not math.isfinite(one.detectable_from):
        return "not identifiable from these shots"
    return f"not identifiable from these shots, which would reveal {_format_detectable(one)} or more"


def _format_detectable(one: Strength) -> str:
    """Format the smallest detectable value."""
    return format_with_unit(format_value(one.detectable_from, 2), one.unit)


def format_undecided(report: DiagnosisReport) -> str:
    """Format which effects were not decided.

    Args:
        report: Result of a diagnosis.

    Returns:
        Sentences on effects that no shot identifies, that these shots are too few to detect, and that they do not test;
        empty if there are none.
    """
    weighed = {one.effect for one in report.candidates}
    never = [format_cause(name) for name in report.unidentifiable if name not in weighed]
    missed = [format_cause(name) for name in report.unidentifiable if name in weighed]
    untested = [format_cause(name) for name in report.not_tested]
    lists = ("Not identifiable from any shot", never), ("Not detectable in these shots at usual strength", missed)
    return " ".join(f"{what}: {', '.join(which)}." for what, which in (*lists, ("Not tested", untested)) if which)


def format_with_unit(number: str, unit: str) -> str:
    """Format a number with its unit; a dimensionless number has none."""
    return number if unit == "1" else f"{number} {format_unit(unit)}"


def format_p_value(p: float) -> str:
    """Format a p-value; one below a millionth is only that."""
    return format_value(p, 2) if p >= 1e-6 else "below 0.000001"
