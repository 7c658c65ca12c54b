"""Answers to an umpire's questions about a shot, each with a probability, a time and a margin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from models.core.scene import CUSHIONS, POCKETS
from models.estimation.contact_test.candidate_contacts import (
    MAX_PROBABILITY,
    MIN_PROBABILITY,
    REST_SPEED,
    CandidateContact,
    find_ball_candidates,
    find_cushion_candidates,
)
from models.estimation.contact_test.shot_record import ShotRecord

SURE_PROBABILITY = 0.9
"""Probability from which an answer is a yes, and below 1 - it a no; between, it is inconclusive."""
POCKET_MOUTH_RADII = 1.6
"""Ball radii from the point of a pocket on the nose rectangle: a centre that comes so near drops."""


@dataclass(frozen=True, slots=True)
class CallAnswer:
    """Answer to one question."""

    probability: float
    t: float
    """s; NaN without a moment."""
    t_sigma: float
    frame: float
    """Fractional frame number of the same moment."""
    margin: float
    """m: gap of two surfaces on free paths (negative: overlap), or distance to a line or pocket (negative: beyond it);
    NaN where there is none.
    """
    margin_sigma: float
    sentence: str
    moved: tuple[str, ...]
    """Balls that moved just before the moment."""
    balls: tuple[str, ...]
    """Balls that take part, for an image of the moment."""
    alternatives: tuple[tuple[str, float], ...] = ()
    """Names of all answers and their probabilities, the most probable first, where there are more than yes and no."""

    @property
    def verdict(self) -> str:
        """Yes, no or inconclusive."""
        return (
            "yes"
            if self.probability > SURE_PROBABILITY
            else "no"
            if self.probability < 1 - SURE_PROBABILITY
            else "inconclusive"
        )


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
    candidates = find_ball_candidates(record, one, two)
    if not candidates:
        return _answer_never_near(record, one, two)
    probability = 1 - float(np.prod([1 - candidate.probability for candidate in candidates]))
    best = max(candidates, key=lambda candidate: candidate.probability)
    sentence = _format_verdict(probability, f"{a} and {b} touched", f"{a} and {b} did not touch")
    return _build_answer(record, best, probability, f"{sentence}; {_format_gap(best.gap, best.gap_sigma)}", (a, b))


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
    names: dict[str, float] = {}
    no_contact_yet = 1.0
    for candidate in sorted(candidates, key=lambda entry: entry.t):
        names[candidate.other] = names.get(candidate.other, 0.0) + no_contact_yet * candidate.probability
        no_contact_yet *= 1 - candidate.probability
    names["none"] = no_contact_yet
    ranked = tuple(sorted(names.items(), key=lambda item: -item[1]))
    name, probability = ranked[0]
    if name == "none":
        nearest = min(candidates, key=lambda entry: abs(entry.gap), default=None)
        sentence = f"{_format_probability(probability)} {a} touched no ball"
        if nearest is None:
            return replace(_answer_without_moment(probability, sentence, a), alternatives=ranked)
        return replace(_build_answer(record, nearest, probability, sentence, (a, nearest.other)), alternatives=ranked)
    best = min(
        (entry for entry in candidates if entry.other == name and entry.probability > 0.5 * probability),
        key=lambda entry: entry.t,
    )
    others = ", ".join(f"{other} {p:.1%}" for other, p in ranked[1:4] if p >= MIN_PROBABILITY)
    sentence = f"{_format_probability(probability)} {a} touched {name} first"
    sentence = f"{sentence} (else {others})" if others else sentence
    return replace(_build_answer(record, best, probability, sentence, (a, name)), alternatives=ranked)


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
    candidates = [*_find_all_ball_candidates(record, one), *find_cushion_candidates(record, one)]
    probability, no_contact_yet, best = 0.0, 1.0, None
    for candidate in sorted(candidates, key=lambda m: m.t):
        if candidate.other in CUSHIONS:
            probability += no_contact_yet * candidate.probability
        if best is None and candidate.probability > 0.5:
            best = candidate
        no_contact_yet *= 1 - candidate.probability
    probability = float(np.clip(probability, MIN_PROBABILITY, MAX_PROBABILITY))
    statement = f"{a} met {'the ' + best.other if best and best.other in CUSHIONS else 'a'} cushion before any ball"
    opposite = f"{a} met {best.other} first" if best else f"{a} met no cushion"
    sentence = _format_verdict(probability, statement, opposite)
    if best is None:
        return _answer_without_moment(probability, sentence, a)
    return _build_answer(record, best, probability, sentence, (a,) if best.other in CUSHIONS else (a, best.other))


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
    centre = record.table.pocket_centres[POCKETS.index(name)]
    distance = np.linalg.norm(record.path[:, one] - centre, axis=1)
    if not np.isfinite(distance).any():
        raise ValueError(f"{a} has too few detections for an answer")
    k = int(np.nanargmin(distance))
    margin, sigma = float(distance[k]) - POCKET_MOUTH_RADII * record.table.ball_radius, float(record.path_sigma[k, one])
    events = record.events
    falls = [e for e in range(len(events)) if events.kind[e] == "pocket" and events.a[e] == a]
    falls_here = [e for e in falls if events.b[e] == name]
    t, t_sigma = float(record.moments[k]), float("nan")
    probability = MIN_PROBABILITY
    if falls_here:
        t, t_sigma, probability = (float(v[falls_here[-1]]) for v in (events.t, events.t_sigma, events.probability))
    probability = float(np.clip(probability, MIN_PROBABILITY, MAX_PROBABILITY))
    other = f"{a} fell into the {events.b[falls[-1]]} pocket" if falls else f"{a} stayed on the table"
    sentence = _format_verdict(probability, f"{a} fell into the {name} pocket", other)
    candidate = CandidateContact(one, name, t, t_sigma, probability, margin, sigma)
    return _build_answer(
        record, candidate, probability, f"{sentence}; {_format_distance(margin, sigma, 'the pocket')}", (a,)
    )


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
    along = record.path[:, one, "xy".index(axis)] - at
    observed = np.flatnonzero(np.isfinite(along))
    if not len(observed):
        raise ValueError(f"{a} has too few detections for an answer")
    side = 1.0 if along[observed[0]] > 0 else -1.0
    remaining = side * along - (record.table.ball_radius if edge else 0.0)  # > 0 while short of the line
    k = int(observed[np.argmin(remaining[observed])])
    margin, sigma = float(remaining[k]), float(max(record.path_sigma[k, one], 1e-5))
    probability = float(np.clip(ndtr(-margin / sigma), MIN_PROBABILITY, MAX_PROBABILITY))
    beyond = observed[remaining[observed] <= 0]
    row = int(beyond[0]) if len(beyond) else k
    speed = abs(float(record.velocity[row, one, "xy".index(axis)]))
    t_sigma = float(record.path_sigma[row, one]) / speed if len(beyond) and speed > REST_SPEED else float("nan")
    subject = f"{'the edge' if edge else 'the centre'} of {a}"
    sentence = _format_verdict(
        probability, f"{subject} crossed {axis}={at:g} m", f"{subject} did not cross {axis}={at:g} m"
    )
    candidate = CandidateContact(one, axis, float(record.moments[row]), t_sigma, probability, margin, sigma)
    return _build_answer(
        record, candidate, probability, f"{sentence}; {_format_distance(margin, sigma, 'the line')}", (a,)
    )


def _answer_never_near(record: ShotRecord, one: int, two: int) -> CallAnswer:
    """Answer for two balls that never came near each other."""
    distance = np.linalg.norm(record.path[:, two] - record.path[:, one], axis=1) - 2 * record.table.ball_radius
    a, b = record.ids[one], record.ids[two]
    if not np.isfinite(distance).any():
        raise ValueError(f"{a} and {b} were never detected at the same time")
    k = int(np.nanargmin(distance))
    sigma = float(np.hypot(np.hypot(*record.path_sigma[k, [one, two]]), record.reach_sigma))
    candidate = CandidateContact(
        one, b, float(record.moments[k]), float("nan"), MIN_PROBABILITY, float(distance[k]), sigma
    )
    sentence = _format_verdict(MIN_PROBABILITY, "", f"{a} and {b} did not touch")
    return _build_answer(record, candidate, MIN_PROBABILITY, f"{sentence}; {_format_gap(candidate.gap, sigma)}", (a, b))


def _build_answer(
    record: ShotRecord, candidate: CandidateContact, probability: float, sentence: str, balls: tuple[str, ...]
) -> CallAnswer:
    step = 2e-3
    moved = tuple(name for name in balls if record.speed_at(record.ball_index(name), candidate.t - step) > REST_SPEED)
    timing = f" at {candidate.t:.4f} s"
    timing += f" ± {1e3 * candidate.t_sigma:.1f} ms" if np.isfinite(candidate.t_sigma) else ""
    frame = record.frame_at(candidate.t)
    movers = f"{' and '.join(moved)} moved" if moved else "no ball moved"
    full = f"{sentence}{timing} (frame {frame:.2f}); just before, {movers}."
    return CallAnswer(
        probability, candidate.t, candidate.t_sigma, frame, candidate.gap, candidate.gap_sigma, full, moved, balls
    )


def _answer_without_moment(probability: float, sentence: str, a: str) -> CallAnswer:
    """Make an answer that has no moment."""
    nan = float("nan")
    return CallAnswer(probability, nan, nan, nan, nan, nan, f"{sentence}.", (), (a,))


def _format_verdict(probability: float, statement: str, opposite: str) -> str:
    if probability > SURE_PROBABILITY:
        return f"Yes, with probability {probability:.1%}: {statement}"
    if probability < 1 - SURE_PROBABILITY:
        return f"No, with probability {1 - probability:.1%}: {opposite}"
    return f"Inconclusive: the probability that {statement} is {probability:.0%}"


def _format_probability(probability: float) -> str:
    """Format the first words of an answer that is one of several."""
    return f"{'With' if probability > SURE_PROBABILITY else 'Inconclusive: with'} probability {probability:.1%}"


def _format_gap(gap: float, sigma: float) -> str:
    if not np.isfinite(gap):
        return "the gap is unknown"
    word = "overlap" if gap < 0 else "pass each other"
    return f"free paths would {word} by {1e3 * abs(gap):.2f} ± {1e3 * sigma:.2f} mm"


def _format_distance(margin: float, sigma: float, target: str) -> str:
    return f"{1e3 * abs(margin):.2f} ± {1e3 * sigma:.2f} mm {'short target' if margin > 0 else 'beyond'} {target}"
