"""Words of calls: question, verdict, margin and reasons, the same for terminal, JSON, page and image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.naming import Naming, join_names
from models.core.number_format import EXTREME_PROBABILITY, format_probability, format_with_sigma
from models.core.scene import CUSHIONS
from models.core.shot_explanation import MIN_LISTED_PROBABILITY
from models.estimation.contact_test.call_answers import UNKNOWN, CallAnswer, CallDoubt

UNDECIDED = "cannot be decided"
MAX_MM_DECIMALS = 1
"""Decimals of millimetres: no place is measured to a hundredth."""
DOUBT_SENTENCES: dict[CallDoubt, str] = {
    "hidden": "a ball was not detected around it",
    "fast": "a ball moved far between two frames",
    "few_samples": "too few frames show the motion before or after",
    "clip_edge": "it happened at the very start or end of the clip",
    "rival": "another ball may have been touched instead",
    "close_pass": "the balls passed so closely that a graze cannot be excluded",
    "no_cause": "a ball changed its velocity for no known cause",
    "moving_at_start": "balls already move when they are first detected",
    "unexplained": "the motion of these balls has no complete explanation",
}
"""Clauses on why a moment is unsure."""


@dataclass(frozen=True, slots=True)
class CallWords:
    """One call in words."""

    question: str
    verdict: str
    """`yes`, `no`, the name of a ball, or `cannot be decided`."""
    probability: str
    """Of the verdict; where it cannot be decided, of the most probable answer, with it."""
    statement: str
    """What happened, when, and how close it was, as a sentence without probability."""
    moment: str
    """When it happened, or was closest; empty where there is no moment."""
    margin: str
    """How close it was, as a clause; empty where the question has no margin."""
    reason: str
    """Why the clip does not decide, and what would; empty where it does."""

    @property
    def sentence(self) -> str:
        """The whole answer."""
        text = f"{self.verdict[0].upper()}{self.verdict[1:]} ({self.probability}): {self.statement}."
        return " ".join(filter(None, [text, self.reason]))


def format_call(call: CallAnswer, naming: Naming) -> CallWords:
    """Format a call.

    Args:
        call: The answer, as codes and values.
        naming: What balls, rails and pockets are called.
    """
    likely = _name_likely_answer(call, naming)
    margin, moment = _format_margin(call, naming), _format_moment(call)
    probability, is_decided = format_probability(call.stated_probability), call.verdict != "inconclusive"
    return CallWords(
        format_call_question(call, naming),
        likely if is_decided else UNDECIDED,
        probability if is_decided else f"{likely}: {probability}",
        _format_statement(call, naming, margin, moment),
        moment,
        margin,
        _format_reason(call),
    )


def format_call_question(call: CallAnswer, naming: Naming) -> str:
    """Format the question of a call, such as `Did the cue ball touch red 3?`."""
    a = naming.say(call.subject[0])
    if call.kind == "contact":
        return f"Did {a} touch {naming.say(call.subject[1])}?"
    if call.kind == "first":
        return f"Which ball did {a} touch first?"
    if call.kind == "cushion-first":
        return f"Did {a} hit a {naming.rail_word} before any ball?"
    if call.kind == "pocket":
        return f"Did {a} fall into the {naming.name_pocket(call.subject[1])}?"
    return f"Did {_say_point(call, naming)} cross the line {_format_line(call)}?"


def _name_likely_answer(call: CallAnswer, naming: Naming) -> str:
    """Name the most probable answer in few words."""
    if call.alternatives:
        return "no ball" if call.met == "none" else naming.name_ball(call.met)
    return "yes" if call.probability >= 0.5 else "no"


def _format_statement(call: CallAnswer, naming: Naming, margin: str, moment: str) -> str:
    """Format what most probably happened, and when; of what did not happen, when it was closest."""
    text, when = _format_fact(call, naming) + _format_others(call, naming), moment and f" at {moment}"
    if not margin or call.probability >= 0.5:
        return "; ".join(filter(None, [text + when, margin]))
    return f"{text}; {margin}{when}"


def _format_fact(call: CallAnswer, naming: Naming) -> str:
    """Format what most probably happened."""
    a, is_yes = naming.say(call.subject[0]), call.probability >= 0.5
    if call.kind == "contact":
        return f"{a} {'touched' if is_yes else 'did not touch'} {naming.say(call.subject[1])}"
    if call.kind == "first":
        return f"{a} touched no ball" if call.met == "none" else f"{a} touched {naming.say(call.met)} first"
    if call.kind == "cushion-first":
        if is_yes:
            rail = naming.say(call.met) if call.met in CUSHIONS else f"a {naming.rail_word}"
            return f"{a} hit {rail} before any ball"
        return f"{a} met {naming.say(call.met)} first" if call.met else f"{a} hit no {naming.rail_word}"
    if call.kind == "pocket":
        if is_yes:
            return f"{a} fell into the {naming.name_pocket(call.subject[1])}"
        return f"{a} fell into the {naming.name_pocket(call.met)}" if call.met else f"{a} stayed on the table"
    return f"{_say_point(call, naming)} {'crossed' if is_yes else 'did not cross'} the line {_format_line(call)}"


def _format_others(call: CallAnswer, naming: Naming) -> str:
    """Format the other possible answers of a question with several, in brackets."""
    others = [
        f"{'an unknown ball' if name == UNKNOWN else 'no ball' if name == 'none' else naming.say(name)}"
        f" {format_probability(p)}"
        for name, p in call.alternatives[1:4]
        if p >= (MIN_LISTED_PROBABILITY if call.met == "none" else EXTREME_PROBABILITY)
    ]
    return f" (else {join_names(others)})" if others else ""


def _format_moment(call: CallAnswer) -> str:
    """Format when it happened."""
    if not np.isfinite(call.t):
        return ""
    sigma = f" ± {1e3 * call.t_sigma:.1f} ms" if np.isfinite(call.t_sigma) else ""
    return f"{call.t:.4f} s{sigma}, frame {call.frame:.1f}"


def _format_margin(call: CallAnswer, naming: Naming) -> str:
    """Format how close a call was; nothing where the free paths say the opposite of all evidence."""
    is_yes = call.probability >= 0.5
    if call.kind in ("first", "cushion-first") or not np.isfinite(call.margin) or (call.margin <= 0) != is_yes:
        return ""
    if call.kind == "contact":
        return format_gap(call.margin, call.margin_sigma)
    inside, target = ("inside", "the mouth of the pocket") if call.kind == "pocket" else ("past", "the line")
    return f"{_format_mm(call.margin, call.margin_sigma)} {'short of' if call.margin > 0 else inside} {target}"


def format_gap(gap: float, sigma: float) -> str:
    """Format how nearly two balls missed or touched each other, by the gap of their free paths (m); empty for NaN."""
    words = "from a miss" if gap < 0 else "of air between them at the closest"
    return f"{_format_mm(gap, sigma)} {words}" if np.isfinite(gap) else ""


def _format_mm(length: float, sigma: float) -> str:
    """Format the amount of a length (m) in mm."""
    return f"{format_with_sigma(1e3 * abs(length), 1e3 * sigma, MAX_MM_DECIMALS)} mm"


def _format_reason(call: CallAnswer) -> str:
    """Format why a question cannot be decided, and which frames would decide it."""
    if call.verdict != "inconclusive":
        return ""
    why = "; ".join(DOUBT_SENTENCES[doubt] for doubt in call.doubts) or "the positions are not known well enough"
    frames = f" Sharp frames around frame {call.doubt_frame:.0f} would decide." if np.isfinite(call.doubt_frame) else ""
    return f"This clip cannot decide it: {why}.{frames}"


def _say_point(call: CallAnswer, naming: Naming) -> str:
    """Name what crosses a line."""
    a = naming.say(call.subject[0])
    return f"the edge of {a}" if "edge" in call.subject[2:] else f"the centre of {a}"


def _format_line(call: CallAnswer) -> str:
    """Format a line across the table."""
    axis, _, at = call.subject[1].partition("=")
    return f"{axis} = {at} m"
