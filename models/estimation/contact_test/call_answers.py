"""Answers to an umpire's questions about a shot, each with a probability, a time and a margin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from models.core.scene import CUSHIONS, POCKETS
from models.core.shot_explanation import Doubt
from models.estimation.contact_test.candidate_contacts import (
    REST_SPEED,
    CandidateContact,
    find_ball_candidates,
    find_cushion_candidates,
    find_unexplained_changes,
)
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.contact_test.unlisted_contacts import (
    is_pair_near,
    list_unclear_times,
    probability_of_unlisted_contact,
    probability_of_unlisted_event,
)

SURE_PROBABILITY = 0.9
"""Probability from which an answer is a yes, and below 1 - it a no; between, it is inconclusive."""
UNKNOWN = "unknown"
"""Name of an answer for a contact with an unknown body."""
UNOBSERVED_PROBABILITY = 0.5
"""Probability of what nothing observed speaks for or against (principle of indifference)."""
MAX_STATED_PROBABILITY = 0.999
"""Largest probability that a sentence states as a number."""
MIN_NAMED_PROBABILITY = 0.001
"""Least probability of another answer that a sentence names."""
DOUBT_TIME = 0.15
"""s around a moment within which doubts concern it."""
VANISH_RADII = 6.0
"""Ball radii from a pocket's mouth, besides the way of three frames, within which a ball that vanishes may have
fallen."""
DOUBT_SENTENCES: dict[Doubt, str] = {
    "hidden": "a ball was not detected around it",
    "fast": "a ball moved far between two frames",
    "few_samples": "too few frames show the motion before or after",
    "clip_edge": "it happened at the very start or end of the clip",
    "rival": "another ball may have been touched instead",
    "close_pass": "the balls passed so closely that a graze cannot be excluded",
    "no_cause": "a ball changed its velocity for no known cause",
}
"""Sentences on why a moment is unsure."""
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
    """Names of all answers and their probabilities, where there are more than yes and no: the stated one first, then
    the most probable ones; `UNKNOWN` stands for a cause that is not known."""
    reason: str = ""
    """Why the clip does not decide the question, and which frames would; empty where it does."""

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
    unlisted = probability_of_unlisted_contact(record, one, two)
    probability = 1 - (1 - unlisted) * float(np.prod([1 - candidate.probability for candidate in candidates]))
    if not candidates:
        return _answer_never_near(record, one, two, probability)
    best = max(candidates, key=lambda candidate: candidate.probability)
    sentence = _format_verdict(probability, f"{a} and {b} touched", f"{a} and {b} did not touch")
    reason = _explain_doubt(record, best.t, (a, b)) if _is_undecided(probability) else ""
    return _build_answer(record, best, probability, f"{sentence}; {_format_gap(best.gap, best.gap_sigma)}", (a, b),
                         reason)  # fmt: skip


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
    moments = [(candidate.t, candidate.other, candidate.probability) for candidate in candidates]
    # an unexplained change was a contact with an unknown body, or none at all
    moments += [(t, UNKNOWN, UNOBSERVED_PROBABILITY * p) for t, p in find_unexplained_changes(record, one)]
    for k, name in enumerate(record.ids):  # another ball that moved for no known cause may have been touched
        if k != one and all(candidate.other != name for candidate in candidates):
            moments += [
                (t, name, UNOBSERVED_PROBABILITY)
                for t in list_unclear_times(record, k)
                if is_pair_near(record, one, k, t)
            ]
    names: dict[str, float] = {}
    no_contact_yet = 1.0
    if any(name in record.explanation.moving_at_start for name in record.ids if name != a):
        names[UNKNOWN], no_contact_yet = UNOBSERVED_PROBABILITY, 1 - UNOBSERVED_PROBABILITY
    for _, other, p in sorted(moments):
        names[other] = names.get(other, 0.0) + no_contact_yet * p
        no_contact_yet *= 1 - p
    unlisted = max((probability_of_unlisted_contact(record, one, k) for k in range(len(record.ids)) if k != one),
                   default=0.0)  # fmt: skip
    names["none"] = no_contact_yet * (1 - unlisted)
    names[UNKNOWN] = names.get(UNKNOWN, 0.0) + no_contact_yet * unlisted
    ranked = tuple(sorted(names.items(), key=lambda item: -item[1]))
    name, probability = ranked[0]
    if name == UNKNOWN or probability < SURE_PROBABILITY:
        named = next(entry for entry in ranked if entry[0] != UNKNOWN)
        reason = _explain_doubt(record, min((t for t, *_ in moments), default=float(record.moments[0])), (a,))
        ranked = (named, *(entry for entry in ranked if entry is not named))
        name, probability = named
    else:
        reason = ""
    if name == "none":
        sentence = f"{_format_probability(probability)} {a} touched no ball"
        return replace(_answer_without_moment(probability, sentence, a, reason), alternatives=ranked)
    best = max(
        (entry for entry in candidates if entry.other == name),
        key=lambda entry: (entry.probability, -entry.t),
        default=None,
    )
    if best is None:
        sentence = f"{_format_probability(probability)} {a} touched {name} first"
        return replace(_answer_without_moment(probability, sentence, a, reason), alternatives=ranked)
    others = ", ".join(
        f"{'an unknown ball' if other == UNKNOWN else other} {_format_share(p)}"
        for other, p in ranked[1:4]
        if p >= MIN_NAMED_PROBABILITY
    )
    sentence = f"{_format_probability(probability)} {a} touched {name} first"
    sentence = f"{sentence} (else {others})" if others else sentence
    return replace(_build_answer(record, best, probability, sentence, (a, name), reason), alternatives=ranked)


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
    moments = [(candidate.t, float(candidate.other in CUSHIONS), candidate.probability) for candidate in candidates]
    # an unknown cause was a cushion or a ball, and so was what came before the clip
    moments += [(t, UNOBSERVED_PROBABILITY, p) for t, p in find_unexplained_changes(record, one)]
    if a in record.explanation.moving_at_start:
        moments.append((float(record.moments[0]), UNOBSERVED_PROBABILITY, 1.0))
    probability, no_contact_yet = 0.0, 1.0
    for _, share, p in sorted(moments):
        probability += no_contact_yet * share * p
        no_contact_yet *= 1 - p
    unlisted = probability_of_unlisted_event()
    probability = float(np.clip(probability, unlisted, 1 - unlisted))
    best = next((candidate for candidate in candidates if candidate.probability > 0.5), None)
    statement = f"{a} met {'the ' + best.other if best and best.other in CUSHIONS else 'a'} cushion before any ball"
    opposite = f"{a} met {best.other} first" if best else f"{a} met no cushion"
    sentence = _format_verdict(probability, statement, opposite)
    t = best.t if best else float(record.moments[0])
    reason = _explain_doubt(record, t, (a,)) if _is_undecided(probability) else ""
    if best is None:
        return _answer_without_moment(probability, sentence, a, reason)
    return _build_answer(
        record, best, probability, sentence, (a,) if best.other in CUSHIONS else (a, best.other), reason
    )


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
    falls = [
        (moment, hypothesis)
        for moment in record.explanation.moments
        if moment.ball == a
        for hypothesis in moment.hypotheses
        if hypothesis.cause == "pocket"
    ]
    here = [(moment, hypothesis) for moment, hypothesis in falls if hypothesis.other == name]
    t, t_sigma = float(record.moments[k]), float("nan")
    probability = UNOBSERVED_PROBABILITY if _vanishes(record, one, margin) else probability_of_unlisted_event()
    if here:
        t, t_sigma, probability = here[-1][0].t, here[-1][0].t_sigma, here[-1][1].probability
    other = f"{a} fell into the {falls[-1][1].other} pocket" if falls else f"{a} stayed on the table"
    sentence = _format_verdict(probability, f"{a} fell into the {name} pocket", other)
    candidate = CandidateContact(one, name, t, t_sigma, probability, margin, sigma)
    reason = _explain_doubt(record, t, (a,)) if _is_undecided(probability) else ""
    return _build_answer(
        record, candidate, probability, f"{sentence}; {_format_distance(margin, sigma, 'the pocket')}", (a,), reason
    )


def _vanishes(record: ShotRecord, one: int, margin: float) -> bool:
    """Return whether a ball that moves is last detected before the end of the clip, near enough to a pocket."""
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
    along = record.path[:, one, "xy".index(axis)] - at
    observed = np.flatnonzero(np.isfinite(along))
    if not len(observed):
        raise ValueError(f"{a} has too few detections for an answer")
    side = 1.0 if along[observed[0]] > 0 else -1.0
    remaining = side * along - (record.table.ball_radius if edge else 0.0)  # > 0 while short of the line
    k = int(observed[np.argmin(remaining[observed])])
    margin, sigma = float(remaining[k]), float(max(record.path_sigma[k, one], 1e-5))
    unlisted = probability_of_unlisted_event()
    probability = float(np.clip(ndtr(-margin / sigma), unlisted, 1 - unlisted))
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


def _answer_never_near(record: ShotRecord, one: int, two: int, probability: float) -> CallAnswer:
    """Answer for two balls that never came near each other."""
    distance = np.linalg.norm(record.path[:, two] - record.path[:, one], axis=1) - 2 * record.table.ball_radius
    a, b = record.ids[one], record.ids[two]
    if not np.isfinite(distance).any():
        raise ValueError(f"{a} and {b} were never detected at the same time")
    k = int(np.nanargmin(distance))
    sigma = float(np.hypot(np.hypot(*record.path_sigma[k, [one, two]]), record.reach_sigma))
    t = float(record.moments[k])
    candidate = CandidateContact(one, b, t, float("nan"), probability, float(distance[k]), sigma)
    sentence = _format_verdict(probability, f"{a} and {b} touched", f"{a} and {b} did not touch")
    reason = _explain_doubt(record, t, (a, b)) if _is_undecided(probability) else ""
    return _build_answer(
        record, candidate, probability, f"{sentence}; {_format_gap(candidate.gap, sigma)}", (a, b), reason
    )


def _build_answer(
    record: ShotRecord,
    candidate: CandidateContact,
    probability: float,
    sentence: str,
    balls: tuple[str, ...],
    reason: str = "",
) -> CallAnswer:
    step = 2e-3
    moved = tuple(name for name in balls if record.speed_at(record.ball_index(name), candidate.t - step) > REST_SPEED)
    timing = f" at {candidate.t:.4f} s"
    timing += f" ± {1e3 * candidate.t_sigma:.1f} ms" if np.isfinite(candidate.t_sigma) else ""
    frame = record.frame_at(candidate.t)
    movers = f"{' and '.join(moved)} moved" if moved else "no ball moved"
    full = f"{sentence}{timing} (frame {frame:.2f}); just before, {movers}.{reason and ' ' + reason}"
    return CallAnswer(
        probability, candidate.t, candidate.t_sigma, frame, candidate.gap, candidate.gap_sigma, full, moved, balls,
        reason=reason,
    )  # fmt: skip


def _answer_without_moment(probability: float, sentence: str, a: str, reason: str = "") -> CallAnswer:
    """Make an answer that has no moment."""
    nan = float("nan")
    full = f"{sentence}.{reason and ' ' + reason}"
    return CallAnswer(probability, nan, nan, nan, nan, nan, full, (), (a,), reason=reason)


def _is_undecided(probability: float) -> bool:
    """Return whether a probability decides nothing."""
    return 1 - SURE_PROBABILITY <= probability <= SURE_PROBABILITY


def _explain_doubt(record: ShotRecord, t: float, balls: tuple[str, ...]) -> str:
    """Explain why a question cannot be decided, and which frames would decide it."""
    doubts: list[Doubt] = []
    for moment in record.explanation.moments:
        if moment.ball in balls and abs(moment.t - t) < DOUBT_TIME:
            doubts += [doubt for doubt in moment.doubts if doubt not in doubts]
    why = [DOUBT_SENTENCES[doubt] for doubt in doubts]
    if any(name in record.explanation.moving_at_start for name in record.ids):
        why.append("balls already move when they are first detected")
    frame = record.frame_at(t)
    cause = "; ".join(why) or "the motion of these balls has no complete explanation"
    return f"It cannot be decided from this clip: {cause}. Sharp frames around frame {frame:.1f} would decide."


def _format_verdict(probability: float, statement: str, opposite: str) -> str:
    if probability > SURE_PROBABILITY:
        return f"Yes, with probability {_format_share(probability)}: {statement}"
    if probability < 1 - SURE_PROBABILITY:
        return f"No, with probability {_format_share(1 - probability)}: {opposite}"
    return f"Inconclusive: the probability that {statement} is {100 * probability:.0f} %"


def _format_probability(probability: float) -> str:
    """Format the first words of an answer that is one of several."""
    return (
        f"{'With' if probability > SURE_PROBABILITY else 'Inconclusive: with'} probability {_format_share(probability)}"
    )


def _format_share(probability: float) -> str:
    """Format a probability; no answer claims more than "above 99.9 %"."""
    return "above 99.9 %" if probability > MAX_STATED_PROBABILITY else f"{100 * probability:.1f} %"


def _format_gap(gap: float, sigma: float) -> str:
    if not np.isfinite(gap):
        return "the gap is unknown"
    word = "overlap" if gap < 0 else "pass each other"
    return f"free paths would {word} by {1e3 * abs(gap):.2f} ± {1e3 * sigma:.2f} mm"


def _format_distance(margin: float, sigma: float, target: str) -> str:
    return f"{1e3 * abs(margin):.2f} ± {1e3 * sigma:.2f} mm {'short of' if margin > 0 else 'beyond'} {target}"
