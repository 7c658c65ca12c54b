"""Answers to a referee's questions of the rules: whether a carom shot scored, and which fouls the clip shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from models.core.errors import NO_STROKE, TrackError
from models.core.fit_result import is_undecided
from models.core.scene import CUSHIONS, POCKETS, Game
from models.core.typing import FloatArray
from models.estimation.contact_test import call_answers as calls
from models.estimation.contact_test import shot_record as contacts
from models.estimation.contact_test.call_answers import UNKNOWN, UNOBSERVED_PROBABILITY, CallAnswer
from models.estimation.contact_test.shot_record import REST_SPEED, CandidateContact, ShotRecord
from models.estimation.segmentation.contact_classification import CUE_KINDS

# Cushion contacts before the second ball that one-cushion and three-cushion carom demand.
CAROM_CUSHIONS = (1, 3)
# Ball classes of the colours of snooker.
COLOURS = ("yellow", "green", "brown", "blue", "pink", "black")
# Groups of balls of which one must be hit first, by game.
FIRST_BALL_GROUPS: dict[Game, tuple[str, ...]] = {
    "pool": ("solids", "stripes", "eight"), "snooker": ("red", "colour"), "carom": (),
}  # fmt: skip
# s before the cue ball moves until which it still rests: two steps of the stored path.
REST_LEAD = 2e-3


def answer_score(record: ShotRecord, ball: str = "") -> CallAnswer:
    """Answer whether the struck ball touched both others, and how many cushions it hit before the second one.

    Args:
        record: The shot.
        ball: Name of the struck ball; empty to find it.

    Returns:
        The answer; its parts are the two contacts and the demands of one-cushion and three-cushion carom.

    Raises:
        ValueError: If there are not three balls, or the struck one is not known.
    """
    if len(record.ids) != 3:
        raise ValueError(f"score is a question of carom, which has three balls; this clip has {len(record.ids)}")
    record, cue = _select_stroke(record, ball)
    one = record.ball_index(cue)
    touches = [calls.list_touches(record, one, k) for k in range(3) if k != one]
    rails, nan = contacts.find_cushion_candidates(record, one), math.nan
    unclear = [CandidateContact(one, UNKNOWN, t, nan, UNOBSERVED_PROBABILITY * p, nan, nan)
               for t, p in contacts.find_unexplained_changes(record, one)]  # fmt: skip
    shares = _count_cushions(touches, [*rails, *unclear])
    if cue in record.explanation.moving_at_start:  # any number of cushions may have come before the clip
        shares = (1 - UNOBSERVED_PROBABILITY) * shares + UNOBSERVED_PROBABILITY * shares.sum() * np.eye(len(shares))[-1]
    first, second = sorted(map(calls.select_touch, touches), key=lambda touch: (touch.probability < 0.5, touch.t))
    path = [entry for entry in (first, second, *rails) if entry.probability > 0.5]
    score = CallAnswer("score", (cue, first.other, second.other), float(shares.sum()), balls=(cue, second.other),
                       path=tuple(sorted(path, key=lambda entry: entry.t)))  # fmt: skip
    score = calls.build_answer(record, score, second)
    parts = [calls.answer_contact(record, cue, touch.other) for touch in (first, second)]
    parts += [
        _judge(record, "cushions", (*score.subject, str(count)), float(shares[count:].sum()), score)
        for count in CAROM_CUSHIONS
    ]
    return replace(score, parts=tuple(parts))


def _count_cushions(touches: Sequence[Sequence[CandidateContact]], rails: Sequence[CandidateContact]) -> FloatArray:
    """Weigh that both balls were touched, with 0, 1, 2, and 3 or more cushions before the second one: (4,).

    Each possible contact is the second touch if no earlier one touched the same ball, and any earlier one the other.
    """
    shares = np.zeros(max(CAROM_CUSHIONS) + 1)
    for own, other in (touches, touches[::-1]):
        for last in own:
            counts = np.zeros_like(shares)
            is_first = math.prod(1 - _precedes(entry, last) for entry in own if entry is not last)
            counts[0] = last.probability * is_first * (1 - math.prod(1 - _precedes(entry, last) for entry in other))
            for rail in rails:
                p = _precedes(rail, last)
                counts = (1 - p) * counts + p * np.array([0.0, *counts[:-2], counts[-2] + counts[-1]])
            shares += counts
    return shares


def _precedes(one: CandidateContact, two: CandidateContact) -> float:
    """Return the probability that the contact `one` happened, and earlier than the time of the contact `two`."""
    if one.t == two.t:  # hypotheses about one moment, which exclude each other
        return 0.0
    sigma = max(float(np.hypot(*np.nan_to_num([one.t_sigma, two.t_sigma]))), 1e-9)
    return one.probability * float(ndtr((two.t - one.t) / sigma))


def answer_foul(record: ShotRecord, ball: str = "", on: str = "") -> CallAnswer:
    """Answer whether the clip shows a foul, by the rules that the games of the table have in common.

    Args:
        record: The shot.
        ball: Name of the cue ball; empty to find it.
        on: What must be hit first: a group of pool, `red` or `colour`, or the id of a ball; empty if unknown.

    Returns:
        The answer; its parts are the facts that it follows from.

    Raises:
        ValueError: If a name is unknown, or the cue ball is not known.
    """
    record, cue = _select_stroke(record, ball)
    if record.table.game == "carom" or len(record.ids) == 1:
        raise ValueError("foul is a question of pool and snooker, with at least two balls; ask score about a carom")
    first, legal, parts = calls.answer_first_contact(record, cue), _find_legal_balls(record, cue, on), []
    names, is_hit = dict(first.alternatives), first.met != "none"
    parts.append(_judge(record, "no-contact", (cue,), names["none"], first))
    if legal and is_hit:
        wrong = sum(p for name, p in names.items() if name in record.ids and name not in legal)
        parts.append(_judge(record, "wrong-ball", (cue, on),
                            wrong + UNOBSERVED_PROBABILITY * names.get(UNKNOWN, 0.0), first))  # fmt: skip
    if record.table.game == "pool" and is_hit:
        parts.append(_answer_no_rail(record, first))
    if record.table.pockets:
        pockets = [calls.answer_pocket(record, cue, name) for name in POCKETS]
        fall = max(pockets, key=lambda entry: (entry.probability, -entry.margin))
        parts.append(_judge(record, "scratch", fall.subject, fall.probability, fall))
    decisive = max(parts, key=lambda part: part.probability)
    is_open = not legal and first.verdict == "inconclusive"  # a wrong ball may have been hit first
    doubtful = UNOBSERVED_PROBABILITY * (1 - first.probability) if is_open else 0.0
    probability = 1 - (1 - doubtful) * math.prod(1 - part.probability for part in parts)
    foul = _judge(record, "foul", (cue, on) if on else (cue,), probability, decisive)
    if is_open and foul.verdict == "no":
        foul = replace(foul, doubts=first.doubts, doubt_frame=first.doubt_frame)
    return replace(foul, parts=(*parts, *_list_frozen(record, first)))


def _judge(
    record: ShotRecord, kind: calls.QuestionKind, subject: tuple[str, ...], p: float, base: CallAnswer
) -> CallAnswer:
    """Answer a question of the rules with probability p at the moment of another answer."""
    unlisted = calls.probability_of_unlisted_event(record, *base.balls)
    p = float(np.clip(p, unlisted, 1 - unlisted))
    t = base.t if math.isfinite(base.t) else float(record.moments[0])
    others = base.alternatives if kind in ("no-contact", "wrong-ball") else ()
    base = replace(base, kind=kind, subject=subject, probability=p, alternatives=others, doubts=(),
                   doubt_frame=math.nan)  # fmt: skip
    return replace(base, **calls.list_doubts(record, t, base.balls, is_undecided(p)))


def _find_legal_balls(record: ShotRecord, cue: str, on: str) -> list[str]:
    """Find the balls that may be hit first; none where it is not known."""
    kinds = COLOURS if on in ("colour", "color") else (on.removesuffix("s"),)
    rows = zip(record.ids, record.kinds, strict=True)
    legal = sorted(name for name, kind in rows if name != cue and (kind in kinds or name == on))
    if on and not legal:
        why = record.naming.explain_no_ball(on) or f"{record.naming.say(on)} is the struck ball"
        raise ValueError(f"{why}; the ball on is one of {', '.join(FIRST_BALL_GROUPS[record.table.game])}, or a ball")
    return legal


def _answer_no_rail(record: ShotRecord, first: CallAnswer) -> CallAnswer:
    """Answer whether no ball reached a rail or a pocket after the first contact."""
    hit = CandidateContact(record.ball_index(first.subject[0]), first.met, first.t, first.t_sigma, 1.0, 0.0, 0.0)
    nan = math.nan
    reached = [
        (CandidateContact(record.ball_index(moment.ball), one.other, moment.t, moment.t_sigma, p, nan, nan), one.cause)
        for moment in record.explanation.moments
        for one in moment.hypotheses
        for p in [one.probability * (UNOBSERVED_PROBABILITY if one.cause == "unexplained" else 1.0)]
        if one.cause in ("cushion", "pocket", "unexplained")
    ]
    none = math.prod(1 - entry.probability * _precedes(hit, entry) for entry, _ in reached)
    likely = [pair for pair in reached if pair[0].probability > 0.5 and pair[0].t > first.t]
    earliest = min(likely, key=lambda pair: pair[0].t, default=None)
    nearest, cause = earliest or (_find_nearest_rail(record, first.t), "cushion")
    name = record.ids[nearest.ball]
    base = calls.build_answer(record, CallAnswer("no-rail", (name,), none, balls=(name,), met=nearest.other), nearest)
    return _judge(record, "no-rail", (first.subject[0], cause), none, base)


def _find_nearest_rail(record: ShotRecord, t: float) -> CandidateContact:
    """Find where a ball came nearest to a cushion that it moved towards after t, s; NaN if that is unknown."""
    after, table = ~(record.moments <= t), record.table
    x, y, vx, vy = (part[after, :, k] for part in (record.path, record.velocity) for k in (0, 1))
    gap = np.stack([x, table.length - x, y, table.width - y], axis=-1) - table.ball_radius  # in the order of CUSHIONS
    gap[~(np.stack([-vx, vx, -vy, vy], axis=-1) > REST_SPEED)] = np.inf
    gap = np.nan_to_num(gap, nan=np.inf)
    row, ball, side = np.unravel_index(int(np.argmin(gap)), gap.shape)
    sigma = record.place_sigma(int(ball), int(np.flatnonzero(after)[row]))
    moment, least = float(record.moments[after][row]), float(gap[row, ball, side])
    return CandidateContact(
        int(ball), CUSHIONS[side], moment, math.nan, 0.0, least if math.isfinite(least) else math.nan, sigma
    )


def _list_frozen(record: ShotRecord, first: CallAnswer) -> list[CallAnswer]:
    """Answer whether the ball that was hit first lay frozen to the cue ball; nothing where it moved before the clip."""
    cue, other = first.subject[0], first.met
    if other not in record.ids or cue in record.explanation.moving_at_start:
        return []
    one, two = record.ball_index(cue), record.ball_index(other)
    before = _cut_record(record, _find_start(record, one) - REST_LEAD)
    if not np.isfinite(before.gaps(one, two)).any():
        return []
    lying = calls.find_nearest_pass(before, one, two)
    base = CallAnswer("frozen", (cue, other), float(ndtr(-lying.gap / lying.gap_sigma)), balls=(cue, other))
    return [_judge(record, "frozen", base.subject, base.probability, calls.build_answer(record, base, lying))]


def find_struck_ball(record: ShotRecord) -> str:
    """Find the ball that was struck: the cue ball that moves first.

    Args:
        record: The shot.

    Returns:
        Name of the ball; empty where no cue ball moves.
    """
    kinds = CUE_KINDS if record.table.game == "carom" else ("cue", "white")  # a yellow ball is an object ball elsewhere
    starts = {name: _find_start(record, k) for k, name in enumerate(record.ids) if record.kinds[k] in kinds}
    return min((name for name, start in starts.items() if math.isfinite(start)), key=starts.__getitem__, default="")


def _select_stroke(record: ShotRecord, ball: str) -> tuple[ShotRecord, str]:
    """Cut the record at the next stroke, and find the ball that was struck; TrackError if all balls rest."""
    if all(math.isinf(_find_start(record, k)) for k in range(len(record.ids))):
        raise TrackError(NO_STROKE)
    struck = find_struck_ball(record)
    cue = ball or struck
    if not cue:
        raise ValueError("no cue ball of this clip moves; name the ball that was struck")
    if math.isinf(_find_start(record, record.ball_index(cue))):
        say = record.naming.say
        raise ValueError(f"{say(cue)} does not move in this clip{f'; {say(struck)} was struck' * bool(struck)}")
    events = record.events
    rows = zip(events.t, events.kind, events.a, events.probability, strict=True)
    strikes = [(float(t), a) for t, kind, a, p in rows if kind == "strike" and p > 0.5]
    stop = next((two[0] for one, two in pairwise(strikes) if one[1] == cue), math.inf)
    return _cut_record(record, stop), cue


def _cut_record(record: ShotRecord, stop: float) -> ShotRecord:
    """Cut what comes after a time, s."""
    before = tuple(moment for moment in record.explanation.moments if moment.t < stop)
    columns = (
        (record.t < stop, ("ball", "t", "xy", "px", "sigma")), (record.shown < stop, ("frame", "shown")),
        (record.moments < stop, ("moments", "path", "velocity", "slip", "path_sigma")),
    )  # fmt: skip
    part = {name: getattr(record, name)[rows] for rows, names in columns for name in names}
    return replace(record, explanation=replace(record.explanation, moments=before), **part)


def _find_start(record: ShotRecord, one: int) -> float:
    """Find when a ball begins to move, s; infinite if it never moves."""
    moving = record.moments[np.hypot(*np.nan_to_num(record.velocity[:, one]).T) > REST_SPEED]
    return float(moving[0]) if len(moving) else math.inf
