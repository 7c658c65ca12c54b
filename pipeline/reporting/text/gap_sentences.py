"""Sentences about a diagnosis of the sim-to-real gap."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from scipy.stats import spearmanr

from diagnosis.fitting.display_names import (
    FORMULAS,
    LAWS,
    format_cause,
    format_growth_variable,
    format_parameter,
    format_phase,
)
from diagnosis.unexplained.force_law import ForceLaw
from diagnosis.unexplained.local_patch import LocalPatch
from diagnosis.verdicts.candidate_probabilities import SMALL_P_VALUE
from diagnosis.verdicts.verdict import CandidateEffect, DiagnosisReport, Strength
from models.core.number_format import (
    EXTREME_PROBABILITY,
    format_probability,
    format_unit,
    format_value,
    format_with_sigma,
)
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from models.physics.mechanisms.mechanism_effect import MechanismEffect
from pipeline.reporting.text.text_formatting import format_law, format_parameter_name

# Share of the gap below which an effect that may close nothing is called small.
SMALL_SHARE = 0.05
# Ratio of the error with stated coefficients to that with fitted ones from which they are called wrong: less is hidden
# by the error of a start.
_CLEARLY_WORSE = 1.2
# Share of an unexplained acceleration from which its law is given as a formula: less than half is left then.
MOST_OF_IT = 0.5
# Rank correlation from which a quantity rises with another, and number of points from which it is asked.
_TREND, _MIN_TREND_POINTS = 0.7, 4
# Ratio to the smallest possible p-value up to which that is stated: three shots more would halve it thrice.
_NEAR_LIMIT = 8.0
# Strengths of an effect that are listed; of more, only the least and the greatest are.
_MOST_STRENGTHS = 6
# Quantities with which a force varies, as sentences name them.
_VARIABLES = {
    "speed": "speed",
    "time": "the time in the shot",
    "x": "place along x",
    "y": "place along y",
    "z": "height",
}


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
    formula: str = ""
    """Law of the effect; empty where no short one states it."""


# Words about films in sentences about a log; not in names of files.
_FILM_WORDS = re.compile(r"(?<![\w./-])([Ss]hot|[Ff]rame)(s?)\b(?!\.\w|[/-])")
# What is no sentence of a page: scripts, styles, and tags.
_MARKUP = re.compile(r"(<(script|style)\b.*?</\2>|<[^>]*>)", re.DOTALL)


def name_runs(scene: str, text: str) -> str:
    """Call the shots and frames of a sentence runs and rows, where a log was diagnosed and no film."""
    if scene != "mechanism":
        return text
    words = {"shot": "run", "Shot": "Run", "frame": "row", "Frame": "Row"}
    return _FILM_WORDS.sub(lambda match: words[match[1]] + match[2], text)


def name_runs_in_page(scene: str, html: str) -> str:
    """Call shots and frames runs and rows in the sentences of a page."""
    if scene != "mechanism":
        return html
    parts, last = [], 0
    for match in _MARKUP.finditer(html):
        parts += [name_runs(scene, html[last : match.start()]), match[0]]
        last = match.end()
    return "".join((*parts, name_runs(scene, html[last:])))


def format_verdict(report: DiagnosisReport) -> str:
    """Format the verdict: which effects the simulator lacks, and that its coefficients are wrong where they are.

    Args:
        report: Result of a diagnosis.

    Returns:
        One sentence or two.
    """
    missing, wrong = _format_missing(report), _format_wrong_coefficients(report)
    if report.verdict == "none" and wrong:
        return f"{wrong} Beyond that, these shots show no effect that your simulator lacks."
    return " ".join(filter(None, (missing, wrong)))


def _format_wrong_coefficients(report: DiagnosisReport) -> str:
    """Format what the wrong coefficients of a simulator cost; empty where they are right, or that is little.

    The error with fitted coefficients alone is no evidence that they are wrong: they take the part of what is missing.
    """
    gap = report.gap
    if (
        not any(one.is_wrongly_stated for one in report.fitted)
        or not gap.as_stated > _CLEARLY_WORSE * gap.closure.before
    ):
        return ""
    stated, fitted = (format_error_size(one, gap.metric) for one in (gap.as_stated, gap.closure.before))
    absent = [format_parameter_name(one.name) for one in report.fitted if one.is_wrongly_stated and one.stated == 0]
    which = f" ({'; '.join(absent)}: it has none)" if absent else ""
    return (
        f"Coefficients of your simulator are wrong{which}: with them, its rms error is {stated}, and {fitted} with"
        " those that fit the recordings."
    )


def _format_missing(report: DiagnosisReport) -> str:
    """Format which effects the simulator lacks."""
    if report.verdict == "effects":
        return f"Your simulator lacks {_list_missing_effects(report)}{_format_large_rest(report)}."
    if report.verdict == "group":
        rivals = " or ".join(format_cause(name) for name in report.candidates[0].group)
        return (
            f"Your simulator lacks {rivals} (these shots cannot distinguish between them){_format_large_rest(report)}."
        )
    if report.verdict == "none":
        return "These shots show no effect that your simulator lacks."
    if report.verdict == "unknown":
        sentence = f"Your simulator lacks an effect that trueroll does not know{_format_main_place(report)}"
        if not report.per_effect:
            return f"{sentence}."
        names = " and ".join(format_cause(one.effect) for one in report.per_effect)
        closed = max(sum(one.closed for one in report.per_effect), 0.0)
        return f"{sentence}; the best that it knows, {names}, would close {format_share(closed)} of it."
    return f"These shots do not allow a verdict: {report.reason}."


def format_agreement(report: DiagnosisReport) -> tuple[str, ...]:
    """Format how improbable it is that shots without a missing effect agree about the named ones as these do.

    Args:
        report: Result of a diagnosis.

    Returns:
        A few sentences per named effect that could be tested; with a group, about its first name.
    """
    named = report.effects or tuple(one.effect for one in report.candidates[:1] if report.verdict == "group")
    sentences = []
    for one in report.candidates:
        p, limit = one.sign_flip_p_value, one.sign_flip_limit
        if one.effect not in named or not math.isfinite(p):
            continue
        share, least = (format_probability(x).replace("below", "less than") if x < 1 else "100 %" for x in (p, limit))
        # stated where so few shots allow hardly less
        few = limit >= EXTREME_PROBABILITY and p <= _NEAR_LIMIT * limit
        bound = f"; with {1 - round(math.log2(limit))} shots this share cannot be below {least}" if few else ""
        weak = " That alone would not exclude chance; the probability above rests on the size of the noise as well."
        asks = (
            "ask for a positive or a negative strength" if one.strengths else "be fitted better or worse by another law"
        )
        sentences.append(
            f"Do the shots agree about {format_cause(one.effect)}? If nothing were missing, each shot would {asks} by"
            f" chance, whatever its noise is, and all of them would agree as well as these do in {share} of"
            f" cases{bound}.{'' if p < SMALL_P_VALUE else weak}"
        )
    return tuple(sentences)


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
    if not rest.is_clear or not math.isfinite(closed):
        return ""
    closing = "close" if len(report.effects) > 1 else "closes"
    after = format_error_size(report.gap.closure.after, report.gap.metric)
    return (
        f", which {closing} {format_share(closed)} of the gap; the error that remains, {after}, is"
        f" {format_value(rest.times_floor, 2)} times the attainable one"
    )


def _list_missing_effects(report: DiagnosisReport) -> str:
    """List the named effects; those that may add nothing to the others come last, with their share of the gap."""
    shares = {one.effect: one for one in report.per_effect}
    unsure = [name for name in report.effects if name in shares and not shares[name].is_measured]
    sure = [name for name in report.effects if name not in unsure]
    if not sure:
        sure, unsure = unsure, []
    together = " and ".join(_format_missing_effect(name, report.forms) for name in sure)
    for name in unsure:
        closed = shares[name].closed
        size = "a small" if closed < SMALL_SHARE else "an uncertain"
        together += f" and, with {size} share ({format_share(closed)}), {_format_missing_effect(name, report.forms)}"
    return together


def format_share(share: float) -> str:
    """Format a share in per cent; nearly all or nearly nothing with a decimal.

    Args:
        share: Of a gap in squared errors; below -1 where the gap more than doubles.

    Returns:
        The share, such as 61 % or 99.4 %.
    """
    if share < -1:
        return "below -100 %"
    if 0 < share <= 0.0005:
        return "less than 0.05 %"
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
    certainty = ""
    if math.isfinite(rest.probability):
        certainty = f", with a probability of {format_probability(rest.probability)}"
    if math.isfinite(rest.share) and rest.size > 0:
        before, after, floor = (format_error_size(one, metric) for one in _list_errors(report))
        share, left = ("All", "it") if rest.share >= 1 else (format_share(rest.share).capitalize(), "the rest")
        sentences.append(
            f"{share} of the gap (in squared errors) remains: the rms error goes from {before} to"
            f" {after}, where {floor} is attainable. No effect that trueroll knows explains {left}, which is more"
            f" than noise{certainty}{details}."
        )
    else:
        sentences.append(f"What remains is more than noise{certainty}{details}.")
    if rest.law is not None:
        sentences.append(_format_law_sentence(rest.law, report.gap.unit))
    if rest.patch is not None:
        p_value = format_p_value(rest.patch.p_value)
        sentences.append(f"A patch: {_format_patch(rest.patch)} (p-value {p_value}).")
    helpful = {share.effect for share in report.per_effect if share.closed > 0}
    named = {one.effect: one for one in report.candidates if one.effect in helpful}
    sentences += [
        f"The strength of {format_cause(name)} differs between shots:"
        f" {format_parameter(s.name)} scatters by {format_with_unit(format_value(s.shot_spread, 2), s.unit)}."
        for name, one in named.items()
        for s in one.strengths
        if s.shot_spread > 0
    ]
    return tuple(sentences)


def _format_law_sentence(law: ForceLaw, unit: str) -> str:
    """Format the direction of an unexplained force, what it varies with, and its nearest formula."""
    units = {"speed": f"{unit}/s", "time": "s"}
    direction = format_law_direction(law)
    variable = _VARIABLES.get(law.variable, law.variable)
    share = (
        f"on other shots this explains {format_share(min(law.explained, 1.0))} of the unexplained acceleration (in"
        " squares, beyond noise)"
    )
    if not explains_most(law):
        trend = "varies with"
        if len(law.at) >= _MIN_TREND_POINTS:
            rank = float(spearmanr(law.at, law.acceleration).statistic)
            steady = "rises with" if rank >= _TREND else "falls with"
            trend = steady if abs(rank) >= _TREND else "varies without a steady trend with"
        return (
            f"It acts in part like an acceleration {direction} that {trend} {variable}; {share}, too little for a"
            " formula."
        )
    formula = (
        f": {law.formula}, with a in {unit}/s² and u the {law.variable} in {units.get(law.variable, unit)}"
        if law.formula
        else ", by no short formula"
    )
    return f"It acts like an acceleration {direction} that varies with {variable}{formula}; {share}."


def format_law_direction(law: ForceLaw) -> str:
    """Format the direction of an unexplained acceleration."""
    return f"{law.direction} the motion" if law.direction in ("along", "across") else f"along {law.direction}"


def explains_most(law: ForceLaw) -> bool:
    """Return whether a law explains most of the unexplained acceleration, so that a formula or a curve stands for it.

    Returns:
        Whether its share on other shots is at least `MOST_OF_IT`.
    """
    return law.explained >= MOST_OF_IT


def _format_patch(patch: LocalPatch) -> str:
    """Format place, size and strength of a patch."""
    kind = "slowed" if patch.strength < 0 else "sped up"
    return (
        f"within {format_with_sigma(1000 * patch.radius, 1000 * patch.radius_sigma, 0)} mm of ({patch.centre[0]:.2f},"
        f" {patch.centre[1]:.2f}) m, bodies are {kind} by"
        f" {format_with_sigma(abs(patch.strength), patch.strength_sigma)} m/s² more than elsewhere"
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
    """Format where most of the gap is: a patch, or a phase of motion; empty if it is not localised."""
    if report.unexplained.patch is not None:
        return f": {_format_patch(report.unexplained.patch)}"
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
    before, after, floor = (format_error_size(value, gap.metric) for value in _list_errors(report))
    # of an own simulator the user must not read the error of its fitted coefficients as that of its file
    whose = ", its coefficients fitted to the recordings," if math.isfinite(gap.as_stated) else ""
    span = f"over the first {gap.horizon:.2f} s of predicting hold-out shots"
    if gap.floor_reason:
        return (
            f"The rms error {span} goes from {before} to {after}; how much of that is attainable is unknown, because"
            f" {gap.floor_reason}."
        )
    is_open = report.verdict == "unknown" or (report.verdict == "undecidable" and closing.resolved)
    if is_open and not closing.after < closing.before:
        return (
            f"The rms error of the simulator{whose} {span} is {before} (attainable: {floor}); no effect that"
            " trueroll knows reduces it."
        )
    if not closing.resolved or not closing.floor < closing.before:
        share = f"of which {floor}" if closing.floor < closing.before else "which"
        # fitting shots found what is missing, and the user shall know that nothing else confirms it
        doubt = "" if report.verdict == "none" else "; so few hold-out shots do not show a gap beyond it"
        return f"The rms error of the simulator{whose} {span} is {before}, {share} is noise{doubt}."
    change = "adding them" if len(report.effects) > 1 else "adding it"
    change = "the most similar effect" if report.verdict == "unknown" else change
    low, high = map(format_share, closing.interval)
    interval = f" (95 % interval: {low} to {high})" if low != high else ""
    return (
        f"{change.capitalize()} reduces the rms error {span} from {before} to {after} (attainable: {floor}):"
        f" {format_share(closing.closed)} of the gap closed{interval}."
    )


def _list_errors(report: DiagnosisReport) -> tuple[float, float, float]:
    """List the error before, after and the attainable one."""
    closing = report.gap.closure
    return closing.before, closing.after, closing.floor


def format_shot_use(report: DiagnosisReport) -> str:
    """Format how many shots there are, what each was used for, and the errors of their positions.

    Args:
        report: Result of a diagnosis.

    Returns:
        One sentence; empty where it is not stated.
    """
    used = report.shot_use
    counts = {
        "to fit": len(used.fitting),
        "to confirm effects": len(used.selection),
        "held out to measure the gap": len(used.holdout),
    }
    total = sum(counts.values())
    if not total:
        return ""
    parts = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    size = format_error_size(used.noise, report.gap.metric)
    noise = f"; each coordinate is measured to {size}, errors that last over several frames included"
    return f"{total} shot{'s' if total > 1 else ''}: {parts}{noise if math.isfinite(used.noise) else ''}."


def format_strength_note(report: DiagnosisReport) -> str:
    """Format what the strengths of effects mean that are not named.

    Args:
        report: Result of a diagnosis.

    Returns:
        Sentences; empty where no such effect was fitted.
    """
    named = {*report.effects, *(one.effect for one in report.candidates[:1] if report.verdict == "group")}
    others = [one for one in report.candidates if one.effect not in named and one.fitted_beside is not None]
    if not others:
        return ""
    best = {one.effect for one in report.per_effect} - named
    if not named and not best:
        how = "alone, added to your simulator"
    elif not named:
        how = f"beside {' and '.join(format_cause(name) for name in sorted(best))}, or alone"
    elif all(one.fitted_beside for one in others):
        how = "beside the named ones"
    elif not any(one.fitted_beside for one in others):
        how = "in place of the named ones"
    else:
        alone = " and ".join(format_cause(one.effect) for one in others if not one.fitted_beside)
        how = f"beside the named ones ({alone}: in place of them)"
    odds = "that it is missing instead of the named ones" if named else "that it is missing"
    return (
        f"Of an effect that is not named, the probability is {odds}; its strength was fitted {how}. That strength may"
        " differ from 0 although the effect is not needed, because it then also imitates whatever else is unexplained."
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
        return tuple(_build_cause(one, report.scene) for one in report.candidates)
    parts = [_build_cause(one, report.scene) for one in together]
    whole = Cause(
        name=" and ".join(one.name for one in parts),
        probability=report.probability,
        strength="; ".join(f"{one.name} {one.strength}" for one in parts if one.strength),
        detectable="; ".join(f"{one.name} {one.detectable}" for one in parts if one.detectable),
        rivals=", ".join(one.rivals for one in parts if one.rivals),
        formula="; ".join(f"{one.name}: {one.formula}" for one in parts if one.formula),
    )
    rest = (_build_cause(one, report.scene) for one in report.candidates if one not in together)
    return tuple(sorted((whole, *rest), key=lambda one: one.probability, reverse=True))


def _build_cause(one: CandidateEffect, scene: str) -> Cause:
    is_long = len(one.strengths) > _MOST_STRENGTHS and one.effect in MECHANISM_EFFECTS
    strengths = _format_strength_ranges(one) if is_long else (format_strength(s) for s in one.strengths)
    detectable = (
        f"{format_parameter(s.name)} {_format_detectable(s)}"
        for s in one.strengths
        if math.isfinite(s.detectable_from) and not is_long
    )
    rivals = (format_cause(name) for name in one.group[1:])
    return Cause(
        format_cause(one.effect),
        one.probability,
        name_runs(scene, "; ".join(filter(None, strengths))),
        "; ".join(detectable),
        ", ".join(rivals),
        FORMULAS.get(scene, {}).get(one.effect, ""),
    )


def _format_strength_ranges(one: CandidateEffect) -> list[str]:
    """Format the least and the greatest strength of an effect with one for each of many places; gap.json has all."""
    effect, phrases = MECHANISM_EFFECTS[one.effect], []
    for strength in effect.strengths:
        own = [s for s in one.strengths if effect.split_parameter(s.name)[0] == strength.name]
        own = [s for s in own if math.isfinite(s.sigma) and s.sigma > 0]  # the others were not fitted
        what = f"{format_parameter(strength.name)} of"
        for unit in dict.fromkeys(s.unit for s in own):
            shown = sorted((s for s in own if s.unit == unit and not s.prior_only), key=lambda s: s.value)
            ends = (
                f"{format_with_sigma(s.value, s.sigma)} ({format_parameter(effect.split_parameter(s.name)[1])})"
                for s in (shown if len(shown) < 2 else (shown[0], shown[-1]))
            )
            if shown:
                after = "" if unit == "1" else f", {format_unit(unit)}"
                phrases.append(f"{what} {_count_places(effect, len(shown))} = {' to '.join(ends)}{after}")
        hidden = sum(s.prior_only for s in own)
        if hidden:
            phrases.append(f"{what} {_count_places(effect, hidden)}: not identifiable")
    return phrases


def _count_places(effect: MechanismEffect, count: int) -> str:
    """Format a number of the places that an effect has parameters for."""
    name = {"actuator": "actuator", "sensor": "sensor", "sensor_body": "sensor"}.get(effect.site, "joint")
    return f"{count} {name}{'s' * (count != 1)}"


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
    never = [format_cause(name) for name in report.unidentifiable if name.partition(".")[0] not in weighed]
    missed = [format_parameter(name) for name in report.unidentifiable if name.partition(".")[0] in weighed]
    untested = _group_by_reason(report.not_tested)
    lists = ("Not identifiable from any shot", never), ("Not detectable in these shots at usual strength", missed)
    return " ".join(f"{what}: {', '.join(which)}." for what, which in (*lists, ("Not tested", untested)) if which)


def _group_by_reason(not_tested: tuple[str, ...]) -> list[str]:
    """Format effects that were not tested; those of one reason together, with it."""
    by_reason: defaultdict[str, list[str]] = defaultdict(list)
    for one in not_tested:
        name, _, reason = one.partition(": ")
        by_reason[reason].append(format_cause(name))
    return [
        name for reason, names in by_reason.items()
        for name in ([f"{' and '.join(names)} ({reason})"] if reason else names)
    ]  # fmt: skip


def format_assumed_effects(report: DiagnosisReport) -> str:
    """Format what the user's simulator contains.

    Args:
        report: Result of a diagnosis.

    Returns:
        Names of effects, or what moves bodies without any.
    """
    names = [format_cause(name) for name in report.model]
    if report.scene == "mechanism" and not names:
        return "none of the effects that trueroll knows"
    if report.scene == "flight":
        return ", ".join(["gravity", *names]) if names else "gravity alone"
    return ", ".join(names) or ("steady motion without any force" if report.scene == "slide" else "none")


def format_with_unit(number: str, unit: str) -> str:
    """Format a number with its unit; a dimensionless number has none."""
    return number if unit == "1" else f"{number} {format_unit(unit)}"


def format_p_value(p: float) -> str:
    """Format a p-value; one below a millionth is only that."""
    return format_value(p, 2) if p >= 1e-6 else "below 0.000001"
