"""The decision about a verdict: from the evidence of fitting and selection shots, confirmed by hold-out shots.

Hold-out shots choose no effect: they only withdraw what they do not confirm, that nothing is missing included.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from diagnosis.fitting.display_names import format_cause
from diagnosis.fitting.gap_closure import GapClosure
from diagnosis.selection.unknown_effects import UnknownEvidence
from diagnosis.verdicts.candidate_probabilities import SMALL_P_VALUE, smallest_p_value
from diagnosis.verdicts.verdict import CandidateEffect, EffectShare, Verdict

# Probability below which an answer is none: its contrary is more probable.
_LEAST_PROBABILITY = 0.5
# Fewest shots that can agree better than chance.
ENOUGH_SHOTS = next(count for count in range(3, 100) if smallest_p_value(count) <= SMALL_P_VALUE)
# Share of the gap that rounds to 0 %.
_LEAST_SHARE = 0.005


@dataclass(frozen=True, slots=True)
class Decision:
    """The verdict of a diagnosis."""

    verdict: Verdict
    named: frozenset[str]
    """Effects that the verdict names."""
    unmeasured: frozenset[str]
    """Effects that were fitted beside them and close no measurable share of the gap."""
    reason: str
    """Why nothing is decided, or why effects were withdrawn; empty where neither is so."""
    notes: tuple[str, ...]
    unknown_probability: float = float("nan")
    """Of `unknown`, where hold-out shots overrule the fit; NaN where they do not."""

    def share_probabilities(self, probabilities: Mapping[str, float]) -> dict[str, float]:
        """Return the probabilities that agree with the verdict.

        Those of effects without a measurable share move to the named ones. Where hold-out shots overrule the fit, what
        they leave to `unknown` is shared as the fit says.
        """
        if math.isfinite(self.unknown_probability):
            rest = (1 - self.unknown_probability) / (1 - probabilities["unknown"])
            shared = {name: rest * value for name, value in probabilities.items()}
            return shared | {"unknown": self.unknown_probability}
        moved = sum(probabilities[name] for name in self.unmeasured)
        others = {name: 0.0 if name in self.unmeasured else value for name, value in probabilities.items()}
        return others | {name: others[name] + moved / len(self.named) for name in self.named}


def decide_verdict(
    evidence: UnknownEvidence,
    named_effects: Mapping[str, CandidateEffect],
    probabilities: Mapping[str, float],
    closure: GapClosure,
    per_effect: tuple[EffectShare, ...],
    shots: int,
    holdout_shots: int,
    is_refuted: bool = False,
    is_rest_clear: bool = False,
) -> Decision:
    """Decide the verdict.

    Where the gap of hold-out shots exceeds noise, something is missing: it is unknown where the effects may close
    nothing and leave more than noise. Where selection shots show no gap, residuals are no evidence, and an effect needs
    shots that agree about it: how they scatter does not depend on the size or the correlation of the noise.

    Args:
        evidence: Evidence for an unknown effect.
        named_effects: The effects of the best hypothesis, with what the shots say of each.
        probabilities: Of all effects, `none` and `unknown`.
        closure: Closure of the gap of hold-out shots.
        per_effect: Part of each effect in it.
        shots: Number of all shots.
        holdout_shots: Number of hold-out shots that were predicted.
        is_refuted: Whether a patch refutes the effects.
        is_rest_clear: Whether the error that remains on hold-out shots clearly exceeds the attainable one.

    Returns:
        The decision.
    """
    names = frozenset(named_effects)
    is_group = len(names) == 1 and any(len(one.group) > 1 for one in named_effects.values())
    supported = evidence.supported
    verdict: Verdict = "none" if not names else ("group" if is_group else "effects")
    if supported.is_unknown or is_refuted:
        verdict = "unknown"
    reason, overruled = "", float("nan")
    # That most of the gap is left. The closure counts blocks of windows where shots are few; the next shot may differ
    # even so (rule of succession).
    left = min(1 - closure.most_probability, (holdout_shots + 1) / (holdout_shots + 2))
    is_unknown_likely = left >= _LEAST_PROBABILITY
    if names and verdict != "unknown" and closure.resolved and closure.interval[0] <= 0:
        low, high = closure.interval
        is_more = is_unknown_likely and (supported.has_systematic_residuals or is_rest_clear)
        verdict, overruled = ("unknown", left) if is_more else ("undecidable", overruled)
        reason = (
            f"hold-out shots do not confirm {format_names(names)}: {_format_share(closure.closed)} of the gap closed,"
            f" with a 95 % interval of {_format_share(low)} to {_format_share(high)} that includes nothing"
        )
    elif verdict == "none" and closure.resolved:
        # a fit of other shots can hide what acts between its windows
        is_more = is_unknown_likely and is_rest_clear
        verdict, overruled = ("unknown", left) if is_more else ("undecidable", overruled)
        reason = (
            "the fit leaves only noise, but hold-out shots are predicted with"
            f" {closure.before / closure.floor:.1f} times the error that noise allows"
        )
    elif evidence.gap == "absent" and verdict != "none":
        reason = _explain_missing_gap(verdict, named_effects.values())
    elif verdict == "effects" and shots < ENOUGH_SHOTS:
        probability = sum(probabilities[name] for name in names)
        if probability < _LEAST_PROBABILITY:
            reason = (
                f"the most probable answer of {shots} shots, {format_names(names)}, has a probability of"
                f" {_format_share(probability)} only"
            )
    is_withdrawn = verdict == "unknown" and evidence.gap != "absent"
    if reason and not is_withdrawn:
        verdict = "undecidable"
    is_named = verdict in ("effects", "group")
    small = {one.effect for one in per_effect if not one.is_measured and one.closed < _LEAST_SHARE}
    named = (names - small or names) if is_named else frozenset[str]()
    unmeasured = names - named if is_named else frozenset[str]()
    notes: list[str] = []
    if verdict == "none" and evidence.gap == "absent" and evidence.has_systematic_residuals:
        notes.append(
            "residuals of the fit are not white noise that is alike in all shots, but other shots are"
            " predicted as well as noise allows: noise that is correlated over many samples, as a filter leaves it,"
            " looks like this"
        )
    if unmeasured:
        notes.append(f"{format_names(unmeasured)} was fitted beside them, without a measurable share of the gap")
    if (is_named or verdict == "unknown") and shots < ENOUGH_SHOTS:
        notes.append(
            f"{shots} shots cannot agree better than chance: {ENOUGH_SHOTS} are the fewest that agree by chance in less"
            f" than {_format_share(SMALL_P_VALUE)} of all cases"
        )
    return Decision(
        verdict, named, unmeasured, reason, tuple(notes), overruled if verdict == "unknown" else float("nan")
    )


def _explain_missing_gap(verdict: Verdict, named_effects: Iterable[CandidateEffect]) -> str:
    """Explain why nothing is decided where selection shots show no gap; empty where shots agree about the effects."""
    fine = "other shots are predicted as well as noise allows"
    if verdict == "unknown":
        return f"{fine}, so that no gap shows what is missing"
    effects = tuple(named_effects)
    names = format_names(frozenset(one.effect for one in effects))
    tested = [one for one in effects if math.isfinite(one.sign_flip_p_value)]
    if not any(one.sign_flip_limit <= SMALL_P_VALUE for one in tested):
        return f"{fine} without {names}, and too few shots are left to agree about it better than chance"
    if any(one.sign_flip_p_value > SMALL_P_VALUE for one in tested):
        return f"{fine} without {names}, and the shots do not agree about it better than chance"
    return ""


def format_names(names: Iterable[str]) -> str:
    """Format the names of effects in a sentence."""
    return " and ".join(format_cause(name) for name in sorted(names))


def _format_share(share: float) -> str:
    return f"{100 * share:.0f} %"
