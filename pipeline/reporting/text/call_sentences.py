"""Words of calls: question, verdict, margin and reasons, the same for terminal, JSON, page and image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from models.core.fit_result import MIN_LISTED_PROBABILITY, is_undecided
from models.core.naming import Naming, join_names
from models.core.number_format import EXTREME_PROBABILITY, format_probability, format_time, format_with_sigma
from models.core.scene import CUSHIONS
from models.estimation.contact_test.call_answers import UNKNOWN, CallAnswer, CallDoubt, QuestionKind
from pipeline.reporting.text.text_formatting import format_meeting, start_sentence

UNDECIDED = "cannot be decided"
# Where the ball on is not known, and a wrong ball may have been hit first.
NO_JUDGED_FOUL = "none of the fouls that can be judged"
# Decimals of millimetres: no place is measured to a hundredth.
MAX_MM_DECIMALS = 1
# m from which a margin is no closeness: a ball rolled on past a line, or lay away from another, by about two balls.
MAX_STATED_MARGIN = 0.1
# Clauses on why a moment is unsure.
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
# Facts in the words of the World Pool-Billiard Association (WPA, rules of 15 March 2016), with their sections.
POOL_RULES: dict[str, str] = {
    "no-contact": "no ball hit (WPA 6.3)", "wrong-ball": "wrong ball first (WPA 6.2)",
    "no-rail": "no rail after contact (WPA 6.3)", "scratch": "cue ball scratch (WPA 6.1)",
    "frozen": "frozen ball (WPA 6.7)",
}  # fmt: skip
# Facts in the words of the World Professional Billiards and Snooker Association.
SNOOKER_RULES = POOL_RULES | {
    "no-contact": "no object ball hit", "wrong-ball": "ball not on hit first", "scratch": "in-off",
    "frozen": "touching ball",
}  # fmt: skip
# Facts of the rules that another question is about.
SAME_FACTS: dict[str, QuestionKind] = {"no-contact": "first", "wrong-ball": "first", "scratch": "pocket"}
# Questions whose answer may be that no ball was touched.
NO_CONTACT: tuple[QuestionKind, ...] = ("first", "no-contact")
# Questions in two words, of any balls; facts of the rules have their name in the rulebook.
TOPICS: dict[QuestionKind, str] = {
    "contact": "touched", "rail": "rail hit", "first": "first ball", "cushion-first": "rail before a ball",
    "pocket": "potted", "line": "line crossed", "score": "score", "cushions": "point with cushions", "foul": "foul",
}  # fmt: skip
# Why a pass is no contact although its gap is within the error: the contact test knows the motion after it too.
UNCHANGED = "; the gap alone would allow a touch, but no ball changed its motion"
# Games by the cushions that they demand before the second ball.
CAROM_GAMES = {"1": "one-cushion", "3": "three-cushion"}


@dataclass(frozen=True, slots=True)
class CallWords:
    """One call in words."""

    question: str
    verdict: str
    """`yes`, `no`, the name of a ball, or `cannot be decided`."""
    likely: str
    """The most probable answer: the verdict, where it can be decided."""
    probability: str
    """Of the most probable answer; where it cannot be decided, with it."""
    statement: str
    """What happened, when, and how close it was, as a sentence without probability."""
    moment: str
    """When it happened, or was closest; empty where there is no moment."""
    margin: str
    """How close it was, as a clause; empty where the question has no margin."""
    reason: str
    """Why the clip does not decide, and what would; empty where it does."""

    @property
    def headline(self) -> str:
        """Verdict and probability."""
        return f"{self.verdict[0].upper()}{self.verdict[1:]} ({self.probability})"

    @property
    def sentence(self) -> str:
        """The whole answer."""
        text = f"{self.headline}: {self.statement}."
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
        likely,
        probability if is_decided else f"{likely}: {probability}",
        _format_statement(call, naming, margin, moment),
        moment,
        margin,
        _format_reason(call),
    )


def format_call_question(call: CallAnswer, naming: Naming) -> str:
    """Format the question of a call, such as `Did the cue ball touch red 3?`."""
    a = naming.say(call.subject[0])
    if call.kind == "foul":
        return f"Does the clip show a foul{''.join(f' (on: {naming.say(on)})' for on in call.subject[1:])}?"
    if call.kind == "score":
        return f"Did {a} score: did it touch both other balls?"
    if call.kind == "cushions":
        return f"Is it a point in {CAROM_GAMES[call.subject[3]]} carom?"
    if call.kind in POOL_RULES:
        return start_sentence(f"{name_rule(call, naming)}?")
    if call.kind == "contact":
        return f"Did {a} touch {naming.say(call.subject[1])}?"
    if call.kind == "rail":
        return f"Did {a} hit {naming.say(call.subject[1])}?"
    if call.kind == "first":
        return f"Which ball did {a} touch first?"
    if call.kind == "cushion-first":
        return f"Did {a} hit a {naming.rail_word} before any ball?"
    if call.kind == "pocket":
        return f"Did {a} fall into the {naming.name_pocket(call.subject[1])}?"
    return f"Did {_say_point(call, naming)} cross the line {_format_line(call)}?"


def _name_likely_answer(call: CallAnswer, naming: Naming) -> str:
    """Name the most probable answer in few words."""
    if call.kind == "first":
        return "no ball" if call.met == "none" else naming.name_ball(call.met)
    if call.kind == "foul":
        if call.probability < 0.5:
            is_judged = len(call.subject) > 1 or any(part.kind == "wrong-ball" for part in call.parts)
            return "no foul" if is_judged else NO_JUDGED_FOUL
        fouls = [part for part in call.parts if part.kind != "frozen" and part.probability >= 0.5]
        fouls = [part for part in fouls if not part.doubts] or fouls
        return join_names(name_rule(part, naming).partition(" (")[0] for part in fouls) or "a foul"
    return "yes" if call.probability >= 0.5 else "no"


def _format_statement(call: CallAnswer, naming: Naming, margin: str, moment: str) -> str:
    """Format what most probably happened, and when; of what did not happen, when it was closest."""
    text = _format_fact(call, naming) + _format_others(call, naming)
    is_timeless = call.kind in ("cushions", "foul") or (
        call.kind in ("pocket", "scratch", "frozen", *NO_CONTACT) and not margin and not _happens(call)
    )
    when = f" at {moment}" if moment and not is_timeless else ""
    if not margin or _happens(call):
        later = call.path[1:] if call.kind in ("contact", "rail") else ()
        again = " and ".join(format_time(one.t, one.t_sigma) for one in later)
        return "; ".join(filter(None, [text + when, margin, again and f"again at {again}"]))
    is_tight = call.kind in ("contact", "score") and is_undecided(float(ndtr(-call.margin / call.margin_sigma)))
    return f"{text}; {margin}{when}{UNCHANGED if is_tight and call.verdict == 'no' else ''}"


def _happens(call: CallAnswer) -> bool:
    """Return whether what a call is about most probably happened: a contact of balls, a rail, a pocket, a line."""
    if call.kind in NO_CONTACT:
        return call.met != "none"
    return (call.probability >= 0.5) != (call.kind == "no-rail")


def _format_fact(call: CallAnswer, naming: Naming) -> str:
    """Format what most probably happened."""
    a, is_yes = naming.say(call.subject[0]), call.probability >= 0.5
    if call.kind in SAME_FACTS:
        return _format_fact(replace(call, kind=SAME_FACTS[call.kind]), naming)
    if call.kind in ("score", "cushions"):
        return _format_score_fact(call, naming)
    if call.kind == "foul":
        shown = [part for part in call.parts if part.kind != "frozen"]
        shown = [part for part in shown if part.verdict == call.verdict] or shown
        if call.verdict == "no":
            return f"ruled out: {', '.join(name_rule(part, naming) for part in shown)}"
        return "; ".join(_format_fact(part, naming) + _format_others(part, naming) for part in shown)
    if call.kind == "no-rail":
        reached = format_meeting("pocket" if call.subject[1] == "pocket" else "cushion", call.met, naming)
        missed = f"no ball met a {naming.rail_word} or fell into a pocket after the first contact"
        return missed if is_yes else f"after the first contact {naming.say(call.balls[0])} {reached}"
    if call.kind == "frozen":
        return f"before the strike {naming.say(call.subject[1])} {'touched' if is_yes else 'did not touch'} {a}"
    if call.kind == "contact":
        return f"{a} {'touched' if is_yes else 'missed'} {naming.say(call.subject[1])}"
    if call.kind == "rail":
        return f"{a} {'hit' if is_yes else 'did not hit'} {naming.say(call.subject[1])}"
    if call.kind == "first":
        nearest = "".join(f", and came nearest to {naming.say(name)}" for name in call.balls[1:])
        return f"{a} touched no ball{nearest}" if call.met == "none" else f"{a} touched {naming.say(call.met)} first"
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


def _format_score_fact(call: CallAnswer, naming: Naming) -> str:
    """Format which balls a ball touched, or how many cushions it met before the second one."""
    second = next((one.t for one in call.path if one.other == call.subject[2]), np.inf)
    count = sum(one.other in CUSHIONS and one.t < second for one in call.path)
    cushions = f"{count or 'no'} {naming.rail_word}{'s' * (count != 1)}"
    if call.kind == "cushions":
        return f"{cushions} before the second ball" if np.isfinite(second) else f"{cushions}, but no second ball"
    a, balls = naming.say(call.subject[0]), [naming.say(name) for name in call.subject[1:]]
    if call.probability >= 0.5:
        return f"{a} touched {balls[0]} and, after {cushions} in all, {balls[1]}"
    met = {one.other for one in call.path}
    missed = " or ".join(naming.say(name) for name in call.subject[1:] if name not in met)
    return f"{a} met {cushions} and missed {missed or balls[1]}"


def format_score(call: CallAnswer, naming: Naming, is_moving: bool) -> str:
    """Format whether a carom shot is a point, such as `No point (99 %): the white missed the red`.

    Args:
        call: The answer.
        naming: What balls are called.
        is_moving: Whether the struck ball still moves at the end, so that it may score later.
    """
    words = format_call(call, naming)
    verdict = {"yes": "Point", "no": "No point within the clip" if is_moving else "No point"}.get(
        words.verdict, f"Point {words.verdict}"
    )
    return f"{verdict} ({words.probability}): {words.statement}."


def format_sequence(call: CallAnswer, naming: Naming) -> str:
    """Format the contacts of a ball in order of time, as a sentence; empty where the question is of no sequence."""
    path = call.path if call.kind == "score" else ()
    contacts = [f"{naming.say(one.other)} at {format_time(one.t, one.t_sigma)}" for one in path]
    return f"In order, {naming.say(call.subject[0])} met {join_names(contacts)}." if contacts else ""


def name_topic(call: CallAnswer, naming: Naming) -> str:
    """Name what a call is about, whichever balls it is about, such as `first ball`."""
    return TOPICS.get(call.kind) or name_rule(call, naming).partition(" (")[0]


def name_rule(call: CallAnswer, naming: Naming) -> str:
    """Name a fact as the rulebook of the game does, such as `no rail after contact (WPA 6.3)`."""
    return (SNOOKER_RULES if naming.game == "snooker" else POOL_RULES)[call.kind]


def _format_others(call: CallAnswer, naming: Naming) -> str:
    """Format the other possible answers of a question with several, in brackets."""
    others = [
        f"{'an unknown ball' if name == UNKNOWN else 'no ball' if name == 'none' else naming.say(name)}"
        f" {format_probability(p)}"
        for name, p in call.alternatives[1:4]
        if p >= (MIN_LISTED_PROBABILITY if call.met == "none" else EXTREME_PROBABILITY)
    ]
    return f" (or {join_names(others)})" if others else ""


def _format_moment(call: CallAnswer) -> str:
    """Format when it happened."""
    if not np.isfinite(call.t):
        return ""
    return f"{format_time(call.t, call.t_sigma)}, frame {call.frame:.1f}"


def _format_margin(call: CallAnswer, naming: Naming) -> str:
    """Format how close a call was; nothing where the free paths say the opposite of all evidence."""
    is_yes = _happens(call)
    if not np.isfinite(call.margin) or (call.margin <= 0) != is_yes:
        return ""
    if call.kind in ("contact", "score") or (call.kind in NO_CONTACT and not is_yes):
        return format_gap(call.margin, call.margin_sigma)
    if call.kind in (*NO_CONTACT, "cushion-first", "wrong-ball", "cushions", "foul"):
        return ""
    if abs(call.margin) > MAX_STATED_MARGIN and (call.kind, is_yes) in (("line", True), ("frozen", False)):
        return ""
    if call.kind == "frozen":
        return f"{_format_mm(call.margin, call.margin_sigma)} {'of overlap' if is_yes else 'of air'} between them"
    targets = {"no-rail": naming.say(call.met), "rail": "it"}
    inside, target = "past", targets.get(call.kind, "the line")
    if call.kind in ("pocket", "scratch"):
        inside, target = "inside", f"the mouth of the {naming.name_pocket(call.subject[1])}"
    return f"{_format_mm(call.margin, call.margin_sigma)} {'short of' if call.margin > 0 else inside} {target}"


def format_gap(gap: float, sigma: float) -> str:
    """Format how nearly two balls missed or touched each other.

    Args:
        gap: m, of their free paths.
        sigma: m, its standard deviation.

    Returns:
        Such as `14.2 ± 1.9 mm from a miss`; empty for NaN.
    """
    words = "from a miss" if gap < 0 else "from a touch"
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
