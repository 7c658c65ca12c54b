"""Answers to a referee's questions of the rules: whether a carom shot scored, and which fouls the clip shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from models.core.scene import CUSHIONS, POCKETS, Game
from models.core.shot_explanation import is_undecided
from models.core.typing import FloatArray
from models.estimation.contact_test import call_answers as calls
from models.estimation.contact_test import candidate_contacts as contacts
from models.estimation.contact_test.call_answers import (
    UNKNOWN,
    UNOBSERVED_PROBABILITY,
    CallAnswer,
    probability_of_unlisted_event,
)
from models.estimation.contact_test.candidate_contacts import REST_SPEED, CandidateContact
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.segmentation.contact_classification import CUE_KINDS

CAROM_CUSHIONS = (1, 3)
"""Cushion contacts before the second ball that one-cushion and three-cushion carom demand."""
LOWEST_BALL_GAMES = ("9-ball", "10-ball")
GAMES: dict[str, Game] = {
    "pool": "pool", "8-ball": "pool", "9-ball": "pool", "10-ball": "pool", "snooker": "snooker", "carom": "carom",
}  # fmt: skip
"""Families by the games whose fouls are told apart."""
COLOURS = ("yellow", "green", "brown", "blue", "pink", "black")
"""Ball classes of the colours of snooker."""
REST_LEAD = 2e-3
"""s before the cue ball moves at which it still rests: two steps of the stored path."""


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
    likely = [rail for rail in rails if rail.probability > 0.5]
    for count in CAROM_CUSHIONS:
        rail = likely[count - 1] if len(likely) >= count and second.probability > 0.5 else None
        part = _judge(record, "cushions", (*score.subject, str(count)), float(shares[count:].sum()), score)
        if rail is not None:
            part = replace(part, lead=second.t - rail.t, lead_sigma=math.hypot(second.t_sigma, rail.t_sigma))
        parts.append(part)
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
    """Return the probability that a possible contact happened, and before another one."""
    if one.t == two.t:  # hypotheses about one moment, which exclude each other
        return 0.0
    sigma = max(float(np.hypot(*np.nan_to_num([one.t_sigma, two.t_sigma]))), 1e-9)
    return one.probability * float(ndtr((two.t - one.t) / sigma))


def answer_foul(record: ShotRecord, ball: str = "", game: str = "", on: str = "") -> CallAnswer:
    """Answer whether the clip shows a foul.

    Args:
        record: The shot.
        ball: Name of the cue ball; empty to find it.
        game: One of `GAMES`; empty for what is common to the games of the table.
        on: What must be hit first: a group of pool, `red` or `colour`, or the id of a ball; empty if unknown.

    Returns:
        The answer; its parts are the facts that it follows from.

    Raises:
        ValueError: If a name is unknown, or the cue ball is not known.
    """
    record, cue = _select_stroke(record, ball)
    game, others = game or record.table.game, [name for name in record.ids if name != cue]
    if game not in GAMES or not others:
        raise ValueError(f"a game is one of {', '.join(GAMES)}; got {game!r}" if others else "there is one ball alone")
    first = calls.answer_first_contact(record, cue)
    names, is_hit = dict(first.alternatives), first.met != "none"
    if not is_hit:
        passes = (calls.find_nearest_pass(record, record.ball_index(cue), record.ball_index(name)) for name in others)
        nearest = min(passes, key=lambda entry: entry.gap)
        first = calls.build_answer(record, replace(first, balls=(cue, nearest.other)), nearest)
    parts, legal = [], _find_legal_balls(record, others, game, on)
    if game != "carom":
        parts.append(_judge(record, "no-contact", (cue,), names["none"], first))
    if legal is not None and is_hit:
        wrong = sum(p for name, p in names.items() if name in others and name not in legal)
        parts.append(_judge(record, "wrong-ball", (cue, *sorted(legal)),
                            wrong + UNOBSERVED_PROBABILITY * names.get(UNKNOWN, 0.0), first))  # fmt: skip
    if game not in ("snooker", "carom") and is_hit:
        parts.append(_answer_no_rail(record, first))
    if record.table.pockets:
        pockets = [calls.answer_pocket(record, cue, name) for name in POCKETS]
        fall = max(pockets, key=lambda entry: (entry.probability, -entry.margin))
        parts.append(_judge(record, "scratch", fall.subject, fall.probability, fall))
    legal_share = math.prod(1 - part.probability for part in parts)
    lost = [name for k, name in enumerate(record.ids) if _is_lost(record, k)]
    unseen = UNOBSERVED_PROBABILITY if lost else 0.0
    parts.append(_judge(record, "off-table", (cue, *lost), unseen, CallAnswer("off-table", (cue,), unseen)))
    decisive = max(parts[:-1] or parts, key=lambda part: part.probability)
    foul = _judge(record, "foul", (cue, game, *(() if legal is None else sorted(legal))), 1 - legal_share, decisive)
    return replace(foul, parts=(*parts, *_list_frozen(record, first)))


def _judge(
    record: ShotRecord, kind: calls.QuestionKind, subject: tuple[str, ...], p: float, base: CallAnswer
) -> CallAnswer:
    """Answer a question of the rules with probability p at the moment of another answer."""
    unlisted = probability_of_unlisted_event()
    p = float(np.clip(p, unlisted, 1 - unlisted))
    t = base.t if math.isfinite(base.t) else float(record.moments[0])
    base = replace(base, kind=kind, subject=subject, probability=p, alternatives=(), doubts=(), doubt_frame=math.nan)
    return replace(base, **calls.list_doubts(record, t, base.balls, is_undecided(p)))


def _find_legal_balls(record: ShotRecord, others: Sequence[str], game: str, on: str) -> set[str] | None:
    """Find the balls that may be hit first; None where it is not known."""
    if game in LOWEST_BALL_GAMES:
        numbers = {record.naming.find_look(name).number: name for name in others}
        return {numbers[1]} if 1 in numbers else {numbers[min(numbers)]} if 0 not in numbers else None
    if not on:
        return None
    kinds = COLOURS if on in ("colour", "color") else (on.removesuffix("s"),)
    legal = {name for name in others if record.kinds[record.ball_index(name)] in kinds or name == on}
    if not legal:
        raise ValueError(f"no ball of this clip is {on!r}; name solids, stripes, eight, red, colour, or a ball")
    return legal


def _answer_no_rail(record: ShotRecord, first: CallAnswer) -> CallAnswer:
    """Answer whether no ball reached a rail or a pocket after the first contact."""
    hit = CandidateContact(record.ball_index(first.subject[0]), first.met, first.t, first.t_sigma, 1.0, 0.0, 0.0)
    nan = math.nan
    reached = [
        CandidateContact(record.ball_index(moment.ball), one.other, moment.t, moment.t_sigma, p, nan, nan)
        for moment in record.explanation.moments
        for one in moment.hypotheses
        for p in [one.probability * (UNOBSERVED_PROBABILITY if one.cause == "unexplained" else 1.0)]
        if one.cause in ("cushion", "pocket", "unexplained")
    ]
    none = math.prod(1 - entry.probability * _precedes(hit, entry) for entry in reached)
    likely = [entry for entry in reached if entry.probability >= 0.5 and entry.t > first.t]
    nearest = min(likely, key=lambda entry: entry.t, default=None) or _find_nearest_rail(record, first.t)
    name = record.ids[nearest.ball]
    base = calls.build_answer(record, CallAnswer("no-rail", (name,), none, balls=(name,), met=nearest.other), nearest)
    return _judge(record, "no-rail", (first.subject[0],), none, base)


def _find_nearest_rail(record: ShotRecord, t: float) -> CandidateContact:
    """Find where a ball came nearest to a cushion that it moved towards after t, s."""
    after, table = record.moments > t, record.table
    x, y, vx, vy = (part[after, :, k] for part in (record.path, record.velocity) for k in (0, 1))
    gap = np.stack([x, table.length - x, y, table.width - y], axis=-1) - table.ball_radius  # in the order of CUSHIONS
    gap[~(np.stack([-vx, vx, -vy, vy], axis=-1) > REST_SPEED)] = np.inf
    gap = np.nan_to_num(gap, nan=np.inf)
    row, ball, side = np.unravel_index(int(np.argmin(gap)), gap.shape)
    sigma = float(np.hypot(record.path_sigma[after][row, ball], record.nose_sigma))
    moment, least = float(record.moments[after][row]), float(gap[row, ball, side])
    return CandidateContact(
        int(ball), CUSHIONS[side], moment, math.nan, 0.0, least if math.isfinite(least) else math.nan, sigma
    )


def _is_lost(record: ShotRecord, one: int) -> bool:
    """Return whether a ball moves when it is last detected, before the end of the clip, and was not potted."""
    last, potted = record.t[record.ball == one][-1:], {name for _, name in _list_events(record, "pocket")}
    is_moving = record.speed_at(one, float(last[0])) > REST_SPEED if len(last) else False
    return is_moving and record.ids[one] not in potted and calls.vanishes(record, one)


def _list_events(record: ShotRecord, kind: str) -> list[tuple[float, str]]:
    """List the times (s) and balls of the probable events of a kind."""
    events = record.events
    columns = zip(events.t, events.kind, events.a, events.probability, strict=True)
    return [(float(t), ball) for t, event_kind, ball, p in columns if event_kind == kind and p > 0.5]


def _list_frozen(record: ShotRecord, first: CallAnswer) -> list[CallAnswer]:
    """Answer whether the ball that was hit first lay frozen to the cue ball; nothing where it moved before the clip."""
    cue, other = first.subject[0], first.met
    if other not in record.ids or cue in record.explanation.moving_at_start:
        return []
    pair = [record.ball_index(cue), record.ball_index(other)]
    t = _find_start(record, pair[0]) - REST_LEAD
    k = int(np.clip(np.searchsorted(record.moments, t), 0, len(record.moments) - 1))
    gap = float(np.hypot(*(record.path[k, pair[1]] - record.path[k, pair[0]]))) - 2 * record.table.ball_radius
    sigma = float(np.hypot(np.hypot(*record.path_sigma[k, pair]), record.reach_sigma))
    if not math.isfinite(gap):
        return []
    lying = CandidateContact(pair[0], other, t, math.nan, float(ndtr(-gap / sigma)), gap, sigma)
    base = calls.build_answer(record, CallAnswer("frozen", (cue, other), lying.probability, balls=(cue, other)), lying)
    return [_judge(record, "frozen", (cue, other), lying.probability, base)]


def _select_stroke(record: ShotRecord, ball: str) -> tuple[ShotRecord, str]:
    """Cut the record at the next stroke, and find the ball that was struck: the cue ball that moves first."""
    strikes = _list_events(record, "strike")
    kinds = CUE_KINDS if record.table.game == "carom" else ("cue", "white")  # a yellow ball is an object ball elsewhere
    starts = {name: _find_start(record, k) for k, name in enumerate(record.ids) if record.kinds[k] in kinds}
    cue = ball or min(starts, key=lambda name: starts[name], default="")
    if not cue or math.isinf(starts.get(cue, 0.0)):
        raise ValueError("no cue ball of this clip moves; name the ball that was struck")
    record.ball_index(cue)
    stop = next((two[0] for one, two in pairwise(strikes) if one[1] == cue), math.inf)
    if not math.isfinite(stop):
        return record, cue
    before = tuple(moment for moment in record.explanation.moments if moment.t < stop)
    columns = (
        (record.t < stop, ("ball", "t", "xy", "px", "sigma")), (record.shown < stop, ("frame", "shown")),
        (record.moments < stop, ("moments", "path", "velocity", "slip", "path_sigma")),
    )  # fmt: skip
    part = {name: getattr(record, name)[rows] for rows, names in columns for name in names}
    return replace(record, explanation=replace(record.explanation, moments=before), **part), cue


def _find_start(record: ShotRecord, one: int) -> float:
    """Find when a ball begins to move, s; infinite if it never moves."""
    moving = record.moments[np.hypot(*np.nan_to_num(record.velocity[:, one]).T) > REST_SPEED]
    return float(moving[0]) if len(moving) else math.inf
