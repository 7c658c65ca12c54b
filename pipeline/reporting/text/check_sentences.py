"""Sentences on the places of a clip that a person should check, and on what is not decided."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from models.core.events import Events
from models.core.fit_result import CauseHypothesis, Moment, ShotExplanation, is_undecided
from models.core.naming import Naming
from models.core.number_format import EXTREME_PROBABILITY, format_moment, format_probability, format_time
from pipeline.reporting.text.call_sentences import DOUBT_SENTENCES
from pipeline.reporting.text.check_list import CheckPlace, CheckReason
from pipeline.reporting.text.text_formatting import name_event, start_sentence

# Least probability of a hypothesis that is named.
MIN_NAMED_PROBABILITY = 0.005
# s between an event and the moment whose hypotheses it belongs to, at most.
MOMENT_TIME = 0.1
# Hypotheses that a sentence names.
MAX_HYPOTHESES = 3
# Reasons that a sentence names besides the main one.
MAX_FURTHER_REASONS = 2
# Words for no cause at all, by the only cause that a moment may have.
NOTHING_WORDS = {"rest": "still moving", "strike": "not struck", "pocket": "not potted"}
# Why a pot is not certain, by what it is concluded from.
FALL_REASONS = {
    "fall": ": it is last detected where its path leads there",
    "vanish": ": it is last detected near there",
}  # fmt: skip
# Doubts that the probabilities show, or that have their own clause with a number of frames.
SELF_EVIDENT_DOUBTS = ("rival", "no_cause", "hidden")


def format_check_place(place: CheckPlace, naming: Naming) -> str:
    """Format the reasons to check a place as one sentence: the ball, what is unsure about it, then why."""
    main, *others = place.reasons
    clauses = [_format_main_clause(main, naming), *_format_doubts(main, naming)]
    # where the doubts name missed frames, a gap would name them again
    named = [one for one in others if one.code != "gap" or one.balls[0] != main.missed_ball]
    clauses += [_format_further_clause(one, main.balls[0], naming) for one in named[:MAX_FURTHER_REASONS]]
    return f"{start_sentence(naming.name_ball(main.balls[0]))}: {'; '.join(dict.fromkeys(clauses))}."


def format_hypotheses(moment: Moment, naming: Naming) -> str:
    """Format the most probable hypotheses of a moment, such as `red 3 61 %, something else 39 %`."""
    return _format_causes(moment, moment.hypotheses, naming)


def format_alternatives(events: Events, k: int, explanation: ShotExplanation, naming: Naming) -> str:
    """Format what may have happened instead of an event, such as `or red 3 8 %`; empty where nothing is named.

    A ball that does not rest yet is no alternative: the time of its rest has an error.
    """
    moment = None if events.kind[k] == "rest" else _find_moment(events, k, explanation)
    if moment is None:
        return ""
    others = [one for one in moment.hypotheses if not _is_event(moment, one, events, k)]
    causes = _format_causes(moment, others, naming)
    category = next((one.category for one in moment.hypotheses if _is_event(moment, one, events, k)), "")
    return causes and f"or {causes}{FALL_REASONS.get(category, '')}"


def format_event_probability(events: Events, k: int, explanation: ShotExplanation, naming: Naming) -> str:
    """Format the probability of event k with its alternatives, which are undecided where it is below 0.9.

    Args:
        k: Which one.
        explanation: What may have happened at each moment.
        naming: What balls, rails and pockets are called.

    Returns:
        Such as `99.8 %`, `95 %, or something else 5 %` or `undecided: 61 %, or red 3 39 %`.
    """
    alternatives = format_alternatives(events, k, explanation, naming)
    begin = "undecided: " if alternatives and is_undecided(events.probability[k]) else ""
    return ", ".join(filter(None, [f"{begin}{format_probability(events.probability[k])}", alternatives]))


def format_least_sure(events: Events, rows: Iterable[int], explanation: ShotExplanation, naming: Naming) -> str:
    """Format the least sure of some events with its probability and alternatives, without a full stop.

    Args:
        rows: Which ones.
        explanation: What may have happened at each moment.
        naming: What balls, rails and pockets are called.

    Returns:
        Such as `yellow 9 falls into the far-left pocket (92 %, or not potted 8 %: it is
        last detected where its path leads there)`; empty where all are as good as certain.
    """
    contacts = (row for row in rows if events.kind[row] != "rest")  # the time of a rest is unsure, not the rest
    k = min(contacts, key=lambda row: events.probability[row], default=None)
    if k is None or events.probability[k] > 1 - EXTREME_PROBABILITY:
        return ""
    return f"{name_event(events, k, naming)} ({format_event_probability(events, k, explanation, naming)})"


def _find_moment(events: Events, k: int, explanation: ShotExplanation) -> Moment | None:
    """Find the moment with the hypothesis that an event stands for; None if there is none."""
    p, t = float(events.probability[k]), float(events.t[k])
    candidates = [
        (abs(one.probability - p), abs(moment.t - t), moment)
        for moment in explanation.moments
        for one in moment.hypotheses
        if abs(moment.t - t) < MOMENT_TIME and _is_event(moment, one, events, k)
    ]
    return min(candidates, key=lambda entry: entry[:2])[2] if candidates else None


def _is_event(moment: Moment, one: CauseHypothesis, events: Events, k: int) -> bool:
    """Return whether an event stands for a hypothesis of a moment."""
    bodies = (events.a[k], events.b[k])
    return one.cause == events.kind[k] and (moment.ball, one.other) in (bodies, bodies[::-1])


def _format_causes(moment: Moment, hypotheses: Sequence[CauseHypothesis], naming: Naming) -> str:
    """Format the most probable of some hypotheses of a moment."""
    causes = {one.cause for one in moment.hypotheses} - {"none"}
    nothing = NOTHING_WORDS.get(causes.pop(), "no contact") if len(causes) == 1 else "no contact"
    named = [one for one in hypotheses[:MAX_HYPOTHESES] if one.probability >= MIN_NAMED_PROBABILITY]
    return ", ".join(f"{_format_cause(one, nothing, naming)} {format_probability(one.probability)}" for one in named)


def _format_cause(hypothesis: CauseHypothesis, nothing: str, naming: Naming) -> str:
    """Format a cause; `nothing` are the words for no cause at all."""
    return {
        "strike": "strike",
        "ball": naming.name_ball(hypothesis.other),
        "cushion": naming.name_rail(hypothesis.other),
        "pocket": naming.name_pocket(hypothesis.other),
        "rest": "at rest",
        "unexplained": "something else",
        "none": nothing,
    }[hypothesis.cause]


def _format_main_clause(reason: CheckReason, naming: Naming) -> str:
    """Format the main reason of a place, without the name of its ball."""
    if reason.code != "undecided" or reason.moment is None:
        return _format_further_clause(reason, reason.balls[0], naming)
    when = format_time(reason.t, reason.moment.t_sigma)
    return f"{_format_question(reason.moment)} at {when} is unsure: {format_hypotheses(reason.moment, naming)}"


def _format_question(moment: Moment) -> str:
    """Format the question that a moment leaves open."""
    causes = {one.cause for one in moment.hypotheses} - {"unexplained", "none"}
    if causes == {"strike"}:
        return "whether it was struck"
    if causes == {"pocket"}:
        return "whether it fell into a pocket"
    if any(one.cause == "none" for one in moment.hypotheses):
        return "whether it touched another ball" if causes == {"ball"} else "whether it met anything"
    return "what it met"


def _format_doubts(reason: CheckReason, naming: Naming) -> list[str]:
    """Format why a moment is unsure."""
    doubts = []
    if reason.missed_ball:
        subject = "it" if reason.missed_ball == reason.balls[0] else naming.say(reason.missed_ball)
        doubts.append(f"{subject} was not detected for {_format_frames(reason.value)}")
    if reason.moment is not None:
        doubts += [DOUBT_SENTENCES[doubt] for doubt in reason.moment.doubts if doubt not in SELF_EVIDENT_DOUBTS]
    return doubts


def _format_further_clause(reason: CheckReason, ball: str, naming: Naming) -> str:
    """Format a reason after others, which name `ball`."""
    it = "it" if reason.balls[0] == ball else naming.say(reason.balls[0])
    its = "its" if it == "it" else f"{it}'s"
    when = format_moment(reason.t) if reason.moment is None else format_time(reason.t, reason.moment.t_sigma)
    if reason.code == "undecided" and reason.moment is not None:
        subject = "" if it == "it" else f" for {it}"
        return f"also unsure{subject} at {when}: {format_hypotheses(reason.moment, naming)}"
    if reason.code == "identity":
        first, other = ("it" if one == ball else naming.say(one) for one in sorted(reason.balls, key=ball.__ne__))
        return f"{first} and {other} pass each other at {when} while neither is detected, so they may be exchanged"
    return {
        "undecided": f"{it} is unsure at {when}",
        "unexplained": f"{it} changes its speed or direction at {when} for no known cause",
        "moving_at_start": f"{it} already moves when it is first detected, at {when}; the cause is not known",
        "gap": f"{it} moves, but is not detected for {_format_frames(reason.value)} around {when}",
        "lost": f"{it} is not detected any more after {when}, although it moves",
        "unfitted": f"{its} motion from {when} to {format_moment(reason.value)} is not explained",
        "outlier": f"{it} is detected {1000 * reason.value:.0f} mm beside {its} path at {when}",
    }[reason.code]


def _format_frames(count: float) -> str:
    """Format a number of frames."""
    return f"{count:.0f} frame{'' if count == 1 else 's'}"
