"""Sentences on the places of a clip that a person should check, and on what is not decided."""

from __future__ import annotations

from models.core.naming import Naming
from models.core.number_format import format_probability
from models.core.shot_explanation import CauseHypothesis, Moment
from pipeline.reporting.text.call_sentences import DOUBT_SENTENCES
from pipeline.reporting.text.check_list import CheckPlace, CheckReason
from pipeline.reporting.text.text_formatting import start_sentence

MIN_NAMED_PROBABILITY = 0.005
"""Least probability of a hypothesis that is named."""
MAX_HYPOTHESES = 3
"""Hypotheses that a sentence names."""
MAX_FURTHER_REASONS = 2
"""Reasons that a sentence names besides the main one."""
SELF_EVIDENT_DOUBTS = ("rival", "no_cause", "hidden")
"""Doubts that the probabilities show, or that have their own clause with a number of frames."""


def format_check_place(place: CheckPlace, naming: Naming) -> str:
    """Format the reasons to check a place as one sentence: the ball, what is unsure about it, then why."""
    main, *others = place.reasons
    clauses = [_format_main_clause(main, naming), *_format_doubts(main, naming)]
    # where the doubts name missed frames, a gap would name them again
    named = [one for one in others if one.code != "gap" or one.balls[0] != main.missed_ball]
    clauses += [_format_further_clause(one, main.balls[0], naming) for one in named[:MAX_FURTHER_REASONS]]
    return f"{start_sentence(naming.name_ball(main.balls[0]))}: {'; '.join(dict.fromkeys(clauses))}."


def format_hypotheses(moment: Moment, naming: Naming) -> str:
    """Format the most probable hypotheses of a moment, such as `red 3 61 %, unexplained 39 %`."""
    is_rest = any(one.cause == "rest" for one in moment.hypotheses)
    is_strike = all(one.cause in ("strike", "none") for one in moment.hypotheses)
    nothing = "still moving" if is_rest else "not struck" if is_strike else "no contact"
    named = [one for one in moment.hypotheses[:MAX_HYPOTHESES] if one.probability >= MIN_NAMED_PROBABILITY]
    return ", ".join(f"{_format_cause(one, nothing, naming)} {format_probability(one.probability)}" for one in named)


def _format_cause(hypothesis: CauseHypothesis, nothing: str, naming: Naming) -> str:
    """Format a cause; `nothing` are the words for no cause at all."""
    return {
        "strike": "strike",
        "ball": naming.name_ball(hypothesis.other),
        "cushion": naming.name_rail(hypothesis.other),
        "pocket": naming.name_pocket(hypothesis.other),
        "rest": "at rest",
        "unexplained": "unexplained",
        "none": nothing,
    }[hypothesis.cause]


def _format_main_clause(reason: CheckReason, naming: Naming) -> str:
    """Format the main reason of a place, without the name of its ball."""
    if reason.code != "undecided" or reason.moment is None:
        return _format_further_clause(reason, reason.balls[0], naming)
    return (
        f"{_format_question(reason.moment)} at {reason.t:.2f} s is unsure: {format_hypotheses(reason.moment, naming)}"
    )


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
    when = f"{reason.t:.2f} s"
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
        "unfitted": f"{its} motion from {when} to {reason.value:.2f} s is not explained",
        "outlier": f"{it} is detected {1000 * reason.value:.0f} mm beside {its} path at {when}",
    }[reason.code]


def _format_frames(count: float) -> str:
    """Format a number of frames."""
    return f"{count:.0f} frame{'' if count == 1 else 's'}"
