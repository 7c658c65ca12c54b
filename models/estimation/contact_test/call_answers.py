"""Answers to an umpire's questions about a shot, each with a probability, a time and a margin.

A contact that no hypothesis lists has a probability that was learned on shots of another engine.
Where every motion of two balls has a cause, hardly any contact is missed. Where one of them turned for an unknown
cause, or already moved when it was first detected, the two may have touched although no contact of them is listed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, TypedDict

import numpy as np
from scipy.special import ndtr

from models.core.fit_result import MIN_LISTED_PROBABILITY, SURE_PROBABILITY, Doubt, is_undecided
from models.core.scene import CUSHIONS, POCKETS
from models.estimation.contact_test.shot_record import (
    REST_SPEED,
    CandidateContact,
    ShotRecord,
    find_ball_candidates,
    find_cushion_candidates,
    find_unexplained_changes,
)
from models.estimation.shot_hypotheses.event_probability import read_event_model
from models.physics.billiards.cushion_geometry import find_mouth_line

# Name of an answer for a contact with an unknown body.
UNKNOWN = "unknown"
_UNKNOWN_CUSHION = "unknown cushion"
_CUSHIONS = (*CUSHIONS, _UNKNOWN_CUSHION)
# Probability of what nothing observed speaks for or against (principle of indifference).
UNOBSERVED_PROBABILITY = 0.5
# s around a moment within which doubts concern it.
DOUBT_TIME = 0.15
# Ball radii from a pocket's mouth, besides the way of three frames, within which a ball that vanishes may have fallen.
VANISH_RADII = 6.0

# Doubts about a moment, or that balls move when they are first detected, or that nothing explains their motion.
CallDoubt = Doubt | Literal["moving_at_start", "unexplained"]
# Questions of an umpire; those from `score` on are of the rules, see `rule_answers`.
QuestionKind = Literal[
    "contact", "rail", "first", "cushion-first", "pocket", "line",
    "score", "cushions", "foul", "no-contact", "wrong-ball", "no-rail", "scratch", "frozen",
]  # fmt: skip


class _Doubts(TypedDict, total=False):
    doubts: tuple[CallDoubt, ...]
    doubt_frame: float


@dataclass(frozen=True, slots=True)
class CallAnswer:
    """Answer to one question, as codes and values; `reporting.text.call_sentences` has the words."""

    kind: QuestionKind
    subject: tuple[str, ...]
    """What the question names: balls, then the pocket or the line."""
    probability: float
    """Of a yes; of the first alternative where there are several answers."""
    t: float = math.nan
    """s; NaN without a moment."""
    t_sigma: float = math.nan
    frame: float = math.nan
    """Fractional frame number of the same moment."""
    margin: float = math.nan
    """m: gap of two surfaces on free paths (negative: overlap), or distance to a line or pocket (negative: beyond it);
    NaN where there is none.
    """
    margin_sigma: float = math.nan
    moved: tuple[str, ...] = ()
    """Balls that moved just before the moment."""
    balls: tuple[str, ...] = ()
    """Balls that take part, for an image of the moment."""
    met: str = ""
    """What was met or reached instead of what the question names: a ball, a cushion, a pocket; empty for nothing."""
    alternatives: tuple[tuple[str, float], ...] = ()
    """Which balls may have been the first one, with their probabilities: the stated one first, then the most probable
    ones; `UNKNOWN` stands for a cause that is not known. Empty where the answer does not depend on it."""
    doubts: tuple[CallDoubt, ...] = ()
    """Why the clip does not decide the question; empty where it does."""
    doubt_frame: float = math.nan
    """Frame around which sharp images would decide."""
    path: tuple[CandidateContact, ...] = ()
    """Probable contacts of the ball in order of time, of the named balls where the question is about a contact."""
    parts: tuple[CallAnswer, ...] = ()
    """Answers that this one follows from."""

    @property
    def verdict(self) -> Literal["yes", "no", "inconclusive"]:
        """Yes, no or inconclusive."""
        if self.doubts or is_undecided(self.probability):
            return "inconclusive"
        return "yes" if self.probability >= SURE_PROBABILITY else "no"

    @property
    def stated_probability(self) -> float:
        """Probability of the most probable answer."""
        return self.probability if self.kind == "first" else max(self.probability, 1 - self.probability)


def answer_contact(record: ShotRecord, a: str, b: str) -> CallAnswer:
    """Answer whether balls a and b touched.

    Args:
        record: The shot.
        a: Name of one ball.
        b: Name of the other ball.

    Returns:
        The answer.

    Raises:
        ValueError: If a ball is unknown, or both are the same.
    """
    one, two = record.ball_index(a), record.ball_index(b)
    if one == two:
        raise ValueError(f"a contact is between two balls; got {a} twice")
    touches = list_touches(record, one, two)
    probability = 1 - math.prod(1 - touch.probability for touch in touches)
    path = tuple(touch for touch in touches if touch.probability > 0.5)
    answer = CallAnswer("contact", (a, b), probability, balls=(a, b), path=path)
    return build_answer(record, answer, select_touch(touches))


def answer_rail(record: ShotRecord, a: str, rail: str) -> CallAnswer:
    """Answer whether a hit a cushion.

    Args:
        record: The shot.
        a: Name of the ball.
        rail: One of `CUSHIONS`.

    Returns:
        The answer.

    Raises:
        ValueError: If the ball or the cushion is unknown, or the ball has too few detections.
    """
    one = record.ball_index(a)
    if rail not in CUSHIONS:
        raise ValueError(f"cushions are {', '.join(CUSHIONS)}; got {rail!r}")
    axis, end = ("xy".index("x" if rail in ("left", "right") else "y"), rail in ("right", "bottom"))
    along, size = record.path[:, one, axis], (record.table.length, record.table.width)[axis]
    gaps = (size - along if end else along) - record.table.ball_radius
    if not np.isfinite(gaps).any():
        raise ValueError(f"{a} has too few detections for an answer")
    unclear = [float(np.interp(t, record.moments, gaps)) for t in list_unclear_times(record, one)]
    is_near = any(not gap > NEAR_RADII * record.table.ball_radius for gap in unclear)
    kind: PairClass = "unclear_near" if is_near else "unclear_far" if unclear else "clear"
    unlisted = probability_of_unlisted_event(record, a, kind=kind)
    hits = [hit for hit in find_cushion_candidates(record, one) if hit.other == rail]
    probability = 1 - math.prod(1 - hit.probability for hit in hits)
    if probability < unlisted:
        k = int(np.nanargmin(gaps))
        nearest = float(record.moments[k]), math.nan, unlisted, float(gaps[k]), record.place_sigma(one, k)
        probability, hits = unlisted, [CandidateContact(one, rail, *nearest)]
    path = tuple(hit for hit in hits if hit.probability > 0.5)
    return build_answer(record, CallAnswer("rail", (a, rail), probability, balls=(a,), path=path), select_touch(hits))


def list_touches(record: ShotRecord, one: int, two: int) -> list[CandidateContact]:
    """List the possible contacts of two balls; at least one, which is as probable as an unlisted contact."""
    touches, unlisted = find_ball_candidates(record, one, two), probability_of_unlisted_contact(record, one, two)
    if 1 - math.prod(1 - touch.probability for touch in touches) >= unlisted:
        return touches
    nearest = select_touch(touches) if touches else find_nearest_pass(record, one, two)
    return [replace(nearest, probability=unlisted)]


def select_touch(touches: Sequence[CandidateContact]) -> CandidateContact:
    """Select the first probable one of possible contacts, else the most probable one."""
    probable = (touch for touch in touches if touch.probability > 0.5)
    return next(probable, max(touches, key=lambda touch: touch.probability))


def answer_first_contact(record: ShotRecord, a: str) -> CallAnswer:
    """Answer which ball a touched first.

    Args:
        record: The shot.
        a: Name of the ball.

    Returns:
        The answer, with the probabilities of all balls.

    Raises:
        ValueError: If the ball is unknown.
    """
    one = record.ball_index(a)
    candidates = _find_all_ball_candidates(record, one)
    meetings = _list_meetings(record, one)
    for k, name in enumerate(record.ids):  # another ball that moved for no known cause may have been touched
        if k != one and all(candidate.other != name for candidate in candidates):
            meetings += [
                (t, {name: UNOBSERVED_PROBABILITY})
                for t in list_unclear_times(record, k)
                if is_pair_near(record, one, k, t)
            ]
    if any(name in record.explanation.moving_at_start for name in record.ids if name != a):
        not_struck = 1 - _probability_of_strike(record, a)  # of a stroke in the clip, no earlier contact is part
        meetings.append((-math.inf, {UNKNOWN: UNOBSERVED_PROBABILITY * not_struck}))
    names, no_contact_yet = _weigh_first(
        [(t, {name: p for name, p in causes.items() if name not in _CUSHIONS}) for t, causes in meetings]
    )
    unlisted = max((probability_of_unlisted_contact(record, one, k) for k in range(len(record.ids)) if k != one),
                   default=0.0)  # fmt: skip
    names["none"] = no_contact_yet * (1 - unlisted)
    names[UNKNOWN] = names.get(UNKNOWN, 0.0) + no_contact_yet * unlisted
    ranked = tuple(sorted(names.items(), key=lambda item: -item[1]))
    name, probability = ranked[0]
    is_doubtful = name == UNKNOWN or probability < SURE_PROBABILITY
    if name == UNKNOWN:
        name, probability = next(entry for entry in ranked if entry[0] != UNKNOWN)
        ranked = ((name, probability), *(entry for entry in ranked if entry[0] != name))
    times = [t for t, _ in meetings if np.isfinite(t)]
    doubts = list_doubts(record, min(times, default=float(record.moments[0])), (a,), is_doubtful)
    fitting = [entry for entry in candidates if entry.other == name]
    best = select_touch(fitting) if fitting else _find_nearest_ball(record, one) if name == "none" else None
    balls = (a,) if best is None else (a, best.other)
    answer = CallAnswer("first", (a,), probability, balls=balls, met=name, alternatives=ranked, **doubts)
    return answer if best is None else build_answer(record, answer, best)


def _probability_of_strike(record: ShotRecord, a: str) -> float:
    """Return the probability that the first motion of a ball begins with a strike in the clip."""
    own = (moment for moment in record.explanation.moments if moment.ball == a)
    first = min(own, key=lambda moment: moment.t, default=None)
    return sum(one.probability for one in first.hypotheses if one.cause == "strike") if first else 0.0


def answer_cushion_first(record: ShotRecord, a: str) -> CallAnswer:
    """Answer whether a met a cushion before any ball.

    Args:
        record: The shot.
        a: Name of the ball.

    Returns:
        The answer.

    Raises:
        ValueError: If the ball is unknown.
    """
    one = record.ball_index(a)
    candidates = sorted(
        [*_find_all_ball_candidates(record, one), *find_cushion_candidates(record, one)], key=lambda entry: entry.t
    )
    meetings = _list_meetings(record, one)
    if a in record.explanation.moving_at_start:  # what came before the clip was a cushion or a ball
        meetings.append((-math.inf, {UNKNOWN: 1 - UNOBSERVED_PROBABILITY, _UNKNOWN_CUSHION: UNOBSERVED_PROBABILITY}))
    weights, _ = _weigh_first(meetings)
    unlisted = probability_of_unlisted_event(record, a)
    probability = float(np.clip(sum(weights.get(name, 0.0) for name in _CUSHIONS), unlisted, 1 - unlisted))
    fitting = [one for one in candidates if one.probability >= MIN_LISTED_PROBABILITY
               and (one.other in CUSHIONS) == (probability >= 0.5)]  # fmt: skip
    best = next((one for one in fitting if one.probability > 0.5), None)
    best = best or max(fitting, key=lambda one: one.probability, default=None)
    met = "" if best is None else best.other
    balls = (a,) if met in ("", *CUSHIONS) else (a, met)
    answer = CallAnswer("cushion-first", (a,), probability, balls=balls, met=met)
    if best is None:
        return replace(answer, **list_doubts(record, float(record.moments[0]), (a,), is_undecided(probability)))
    return build_answer(record, answer, best)


def _list_meetings(record: ShotRecord, one: int) -> list[tuple[float, dict[str, float]]]:
    """List what a ball may have met at each moment; the probabilities of one moment exclude each other.

    An unexplained change was a cushion with a probability equal to the share of cushions among all causes of its
    moment; for this share, the unexplained cause counts half as a cushion.
    """
    meetings: dict[float, dict[str, float]] = {}
    for candidate in (*_find_all_ball_candidates(record, one), *find_cushion_candidates(record, one)):
        meetings.setdefault(candidate.t, {})[candidate.other] = candidate.probability
    for t, p in find_unexplained_changes(record, one):
        causes = meetings.setdefault(t, {})
        of_cushions = sum(causes.get(name, 0.0) for name in CUSHIONS) + UNOBSERVED_PROBABILITY * p
        share = of_cushions / max(sum(causes.values()) + p, 1e-12)
        causes |= {UNKNOWN: (1 - share) * p, _UNKNOWN_CUSHION: share * p}
    racks = [(rack.t, {UNKNOWN: 1.0}) for rack in record.explanation.breaks if record.ids[one] in rack.rack]
    return [*meetings.items(), *racks]


def _weigh_first(meetings: list[tuple[float, dict[str, float]]]) -> tuple[dict[str, float], float]:
    """Weigh what was met first, by its name, and that nothing was."""
    weights: dict[str, float] = {}
    nothing_yet = 1.0
    for _, causes in sorted(meetings, key=lambda entry: entry[0]):
        total = sum(causes.values())
        for name, p in causes.items():
            weights[name] = weights.get(name, 0.0) + nothing_yet * p / max(total, 1.0)
        nothing_yet *= 1 - min(total, 1.0)
    return weights, nothing_yet


@lru_cache(maxsize=4)
def _find_all_ball_candidates(record: ShotRecord, one: int) -> tuple[CandidateContact, ...]:
    """Find every moment at which a ball may have touched another one; cached, since several questions need them."""
    return tuple(
        candidate for k in range(len(record.ids)) if k != one for candidate in find_ball_candidates(record, one, k)
    )


def answer_pocket(record: ShotRecord, a: str, name: str) -> CallAnswer:
    """Answer whether a fell into a pocket.

    Args:
        record: The shot.
        a: Name of the ball.
        name: Name of the pocket.

    Returns:
        The answer.

    Raises:
        ValueError: If the ball or the pocket is unknown, or the ball has too few detections.
    """
    one = record.ball_index(a)
    if not record.table.pockets:
        raise ValueError("this table has no pockets")
    if name not in POCKETS:
        raise ValueError(f"pockets are {', '.join(POCKETS)}; got {name!r}")
    gap = find_mouth_line(record.table, name).measure_gap(record.path[:, one])
    if not np.isfinite(gap).any():
        raise ValueError(f"{a} has too few detections for an answer")
    k = int(np.nanargmin(gap))
    margin, sigma = float(gap[k]), record.place_sigma(one, k)
    falls = [
        (moment, hypothesis)
        for moment in record.explanation.moments
        if moment.ball == a
        for hypothesis in moment.hypotheses
        if hypothesis.cause == "pocket"
    ]
    here = [(moment, hypothesis) for moment, hypothesis in falls if hypothesis.other == name]
    t, t_sigma = float(record.moments[k]), float("nan")
    unlisted = probability_of_unlisted_event(record, a)
    probability = UNOBSERVED_PROBABILITY if _vanishes(record, one, margin) else unlisted
    if here:
        t, t_sigma, probability = here[-1][0].t, here[-1][0].t_sigma, max(here[-1][1].probability, unlisted)
    candidate = CandidateContact(one, name, t, t_sigma, probability, margin, sigma)
    met = next((one.other for _, one in reversed(falls) if one.other != name and one.probability > 0.5), "")
    return build_answer(record, CallAnswer("pocket", (a, name), probability, balls=(a,), met=met), candidate)


def _vanishes(record: ShotRecord, one: int, margin: float) -> bool:
    """Return whether a ball is last detected before the end of the clip, near enough to a pocket at a margin in m."""
    times = record.t[record.ball == one]
    if not len(times) or not len(record.shown):
        return True
    interval = float(np.median(np.diff(record.shown))) if len(record.shown) > 1 else 0.0
    speed = record.speed_at(one, float(times[-1]) - interval)
    reach = VANISH_RADII * record.table.ball_radius + 3 * interval * speed
    return bool(times[-1] < record.shown[-1] - 1.5 * interval and margin < reach)


def answer_line(record: ShotRecord, a: str, axis: str, at: float, edge: bool) -> CallAnswer:
    """Answer whether the centre of a, or its edge, crossed a line.

    Args:
        record: The shot.
        a: Name of the ball.
        axis: `x` or `y`.
        at: Coordinate of the line, m.
        edge: Use the leading edge of the ball instead of its centre.

    Returns:
        The answer.

    Raises:
        ValueError: If the ball or the axis is unknown, or the ball has too few detections.
    """
    one = record.ball_index(a)
    if axis not in ("x", "y"):
        raise ValueError(f"a line is x=... or y=... in metres; got {axis!r}")
    end = record.table.length if axis == "x" else record.table.width
    if not 0 <= at <= end:
        raise ValueError(f"the table reaches from {axis}=0 to {axis}={end:g} m; {axis}={at:g} is no line on it")
    along = record.path[:, one, "xy".index(axis)] - at
    observed = np.flatnonzero(np.isfinite(along))
    if not len(observed):
        raise ValueError(f"{a} has too few detections for an answer")
    side = 1.0 if along[observed[0]] > 0 else -1.0
    remaining = side * along - (record.table.ball_radius if edge else 0.0)  # > 0 while short of the line
    k = int(observed[np.argmin(remaining[observed])])
    scale_sigma = 0.0 if record.camera is None else record.camera.scale_sigma * at
    margin, sigma = float(remaining[k]), math.hypot(record.place_sigma(one, k), scale_sigma)
    unlisted = probability_of_unlisted_event(record, a)
    probability = float(np.clip(ndtr(-margin / sigma), unlisted, 1 - unlisted))
    beyond = observed[remaining[observed] <= 0]
    row = int(beyond[0]) if len(beyond) else k
    speed = abs(float(record.velocity[row, one, "xy".index(axis)]))
    t_sigma = record.place_sigma(one, row) / speed if len(beyond) and speed > REST_SPEED else float("nan")
    candidate = CandidateContact(one, axis, float(record.moments[row]), t_sigma, probability, margin, sigma)
    subject = (a, f"{axis}={at:g}", *(("edge",) if edge else ()))
    return build_answer(record, CallAnswer("line", subject, probability, balls=(a,)), candidate)


def find_nearest_pass(record: ShotRecord, one: int, two: int) -> CandidateContact:
    """Find the moment at which two balls were nearest, as a contact that did not happen."""
    gaps = record.gaps(one, two)
    if not np.isfinite(gaps).any():
        raise ValueError(f"{record.ids[one]} and {record.ids[two]} were never detected at the same time")
    k = int(np.nanargmin(gaps))
    sigma, t = record.gap_sigma(one, two, k), float(record.moments[k])
    return CandidateContact(one, record.ids[two], t, math.nan, 0.0, float(gaps[k]), sigma)


def _find_nearest_ball(record: ShotRecord, one: int) -> CandidateContact | None:
    """Find the nearest pass of a ball and any other one; None where no other one is known."""
    others = [k for k in range(len(record.ids)) if k != one and np.isfinite(record.gaps(one, k)).any()]
    return min((find_nearest_pass(record, one, k) for k in others), key=lambda entry: entry.gap, default=None)


def build_answer(record: ShotRecord, answer: CallAnswer, candidate: CandidateContact) -> CallAnswer:
    """Complete an answer by the moment and the margin of a contact, and by doubts where it is not decided."""
    step = 2e-3
    moved = tuple(
        name for name in answer.balls if record.speed_at(record.ball_index(name), candidate.t - step) > REST_SPEED
    )
    is_doubtful = answer.kind != "first" and is_undecided(answer.probability)
    return replace(
        answer, t=candidate.t, t_sigma=candidate.t_sigma, frame=record.frame_at(candidate.t), margin=candidate.gap,
        margin_sigma=candidate.gap_sigma, moved=moved, **list_doubts(record, candidate.t, answer.balls, is_doubtful),
    )  # fmt: skip


def list_doubts(record: ShotRecord, t: float, balls: tuple[str, ...], is_doubtful: bool) -> _Doubts:
    """List why a question cannot be decided, and the frame that would decide it; nothing where it is decided."""
    if not is_doubtful:
        return {}
    doubts: list[CallDoubt] = []
    for moment in record.explanation.moments:
        if moment.ball in balls and abs(moment.t - t) < DOUBT_TIME:
            doubts += [doubt for doubt in moment.doubts if doubt not in doubts]
    if any(name in record.explanation.moving_at_start for name in record.ids):
        doubts.append("moving_at_start")
    return {"doubts": tuple(doubts or ["unexplained"]), "doubt_frame": record.frame_at(t)}


PairClass = Literal["clear", "unclear_far", "unclear_near"]
# Probability of an unexplained change from which the motion of a ball is unclear.
UNCLEAR_PROBABILITY = 0.05
# Ball radii between two surfaces within which an unlisted contact is likelier: what a ball at 5 m/s goes in two frames
# at 30 fps.
NEAR_RADII = 8.0


def list_unclear_times(record: ShotRecord, ball: int) -> list[float]:
    """List when a ball moved for an unknown reason: unexplained changes, breaks, and its first detection if it moved.

    Args:
        record: The shot.
        ball: Index of the ball.

    Returns:
        Times, s.
    """
    name, explanation = record.ids[ball], record.explanation
    times = [
        moment.t
        for moment in explanation.moments
        if moment.ball == name and moment.best.cause != "strike"
        for one in moment.hypotheses
        if one.cause == "unexplained" and one.probability >= UNCLEAR_PROBABILITY
    ]
    times += [one.end for one in explanation.breaks if name in one.rack and one.end > one.t]
    own = record.t[record.ball == ball]
    return times + ([float(own[0])] if name in explanation.moving_at_start and len(own) else [])


def classify_pair(record: ShotRecord, one: int, two: int) -> PairClass:
    """Classify two balls by how an unlisted contact could have been missed.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        `clear` where the motion of both is explained, `unclear_near` where they were near each other when that of one
        was not, else `unclear_far`. A ball that lies still before and after a moment was not touched then.
    """
    unclear = list_unclear_times(record, one) + list_unclear_times(record, two)
    ends = {rack.end for rack in record.explanation.breaks}  # a break moves balls of the rack by less than is seen
    times = [t for t in unclear if t in ends or not any(_lies_still(record, ball, t) for ball in (one, two))]
    if not times:
        return "clear"
    return "unclear_near" if any(is_pair_near(record, one, two, t) for t in times) else "unclear_far"


def _lies_still(record: ShotRecord, ball: int, t: float) -> bool:
    """Return whether a ball is at rest before and after a moment."""
    speeds = (record.speed_at(ball, t - DOUBT_TIME), record.speed_at(ball, t + DOUBT_TIME))
    return all(speed < REST_SPEED for speed in speeds)


def is_pair_near(record: ShotRecord, one: int, two: int, t: float) -> bool:
    """Return whether two balls were so near at a time that a contact may have been missed.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.
        t: s.

    Returns:
        Whether their surfaces were within `NEAR_RADII`, or their distance is not known.
    """
    distance = float(np.hypot(*(record.position_at(two, t) - record.position_at(one, t))))
    return not distance > (2 + NEAR_RADII) * record.table.ball_radius


def probability_of_unlisted_contact(record: ShotRecord, one: int, two: int) -> float:
    """Return the probability of a contact of two balls that no hypothesis lists.

    Args:
        record: The shot.
        one: Index of a ball.
        two: Index of the other ball.

    Returns:
        The learned share of such pairs that touched.
    """
    kind = classify_pair(record, one, two)
    return probability_of_unlisted_event(record, record.ids[one], record.ids[two], kind=kind)


def probability_of_unlisted_event(record: ShotRecord, *balls: str, kind: PairClass = "clear") -> float:
    """Return the probability of an event that no hypothesis lists.

    Args:
        record: The shot.
        balls: Names of the balls that the event is about.
        kind: How it could have been missed; by default their motion is clear.

    Returns:
        Where the premises of the balls hold, the learned share of such pairs that touched without a listed contact;
        else that of what nothing observed speaks for or against.
    """
    premise = record.explanation.premise_probability(*balls)
    return premise * read_event_model().unlisted_contact[kind] + (1 - premise) * UNOBSERVED_PROBABILITY
