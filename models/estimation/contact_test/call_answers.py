"""An umpire's calls: a question about a shot, answered with a probability, a time and a margin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from models.core.scene import CUSHIONS, POCKETS
from models.estimation.contact_test.candidate_contacts import (
    ALWAYS,
    NEVER,
    RESTS,
    Moment,
    ball_moments,
    cushion_moments,
)
from models.estimation.contact_test.shot_record import Record

SURE = 0.9
"""Probability from which a call is a yes, and below 1 - it a no; between, it is inconclusive."""
MOUTH = 1.6
"""ball radii from the point of a pocket on the nose rectangle: a centre that comes so near drops."""


@dataclass(frozen=True, slots=True)
class Call:
    """The answer to one question."""

    probability: float
    t: float
    """s; NaN where there is no moment to speak of."""
    t_sigma: float
    frame: float
    """The same moment in pictures, fractional."""
    margin: float
    """m: gap of two surfaces on free paths (negative: overlap), or how far something is short of a line or pocket
    (negative: beyond); NaN where there is none."""
    margin_sigma: float
    sentence: str
    moved: tuple[str, ...]
    """Who moved just before the moment."""
    balls: tuple[str, ...]
    """Who takes part, for a picture of the moment."""
    alternatives: tuple[tuple[str, float], ...] = ()
    """Names of all answers and their probabilities, the likeliest first, where there are more than yes and no."""

    @property
    def verdict(self) -> str:
        """yes, no or inconclusive."""
        return "yes" if self.probability > SURE else "no" if self.probability < 1 - SURE else "inconclusive"


def contact(record: Record, a: str, b: str) -> Call:
    """Did balls a and b touch?"""
    one, two = record.number(a), record.number(b)
    if one == two:
        raise ValueError(f"a contact is between two balls; got {a} twice")
    moments = ball_moments(record, one, two)
    if not moments:
        return _far_apart(record, one, two)
    probability = 1 - float(np.prod([1 - m.probability for m in moments]))
    best = max(moments, key=lambda m: m.probability)
    sentence = _told(probability, f"{a} and {b} touched", f"{a} and {b} did not touch")
    return _answer(record, best, probability, f"{sentence}; {_margin(best.gap, best.gap_sigma)}", (a, b))


def first(record: Record, a: str) -> Call:
    """Which ball did a touch first?"""
    one = record.number(a)
    moments = _meetings(record, one)
    names: dict[str, float] = {}
    open_still = 1.0
    for moment in sorted(moments, key=lambda m: m.t):
        names[moment.other] = names.get(moment.other, 0.0) + open_still * moment.probability
        open_still *= 1 - moment.probability
    names["none"] = open_still
    ranked = tuple(sorted(names.items(), key=lambda item: -item[1]))
    name, probability = ranked[0]
    if name == "none":
        nearest = min(moments, key=lambda m: abs(m.gap), default=None)
        sentence = f"{_likely(probability)} {a} touched no ball"
        if nearest is None:
            return replace(_nowhere(probability, sentence, a), alternatives=ranked)
        return replace(_answer(record, nearest, probability, sentence, (a, nearest.other)), alternatives=ranked)
    best = min((m for m in moments if m.other == name and m.probability > 0.5 * probability), key=lambda m: m.t)
    others = ", ".join(f"{other} {p:.1%}" for other, p in ranked[1:4] if p >= NEVER)
    sentence = f"{_likely(probability)} {a} touched {name} first"
    sentence = f"{sentence} (else {others})" if others else sentence
    return replace(_answer(record, best, probability, sentence, (a, name)), alternatives=ranked)


def cushion_first(record: Record, a: str) -> Call:
    """Did a meet a cushion before any ball?"""
    one = record.number(a)
    moments = [*_meetings(record, one), *cushion_moments(record, one)]
    probability, open_still, best = 0.0, 1.0, None
    for moment in sorted(moments, key=lambda m: m.t):
        if moment.other in CUSHIONS:
            probability += open_still * moment.probability
        if best is None and moment.probability > 0.5:
            best = moment
        open_still *= 1 - moment.probability
    probability = float(np.clip(probability, NEVER, ALWAYS))
    what = f"{a} met {'the ' + best.other if best and best.other in CUSHIONS else 'a'} cushion before any ball"
    against = f"{a} met {best.other} first" if best else f"{a} met no cushion"
    sentence = _told(probability, what, against)
    if best is None:
        return _nowhere(probability, sentence, a)
    return _answer(record, best, probability, sentence, (a,) if best.other in CUSHIONS else (a, best.other))


@lru_cache(maxsize=4)
def _meetings(record: Record, one: int) -> tuple[Moment, ...]:
    """Every moment at which a ball may have touched another one: several questions begin with them."""
    return tuple(m for k in range(len(record.ids)) if k != one for m in ball_moments(record, one, k))


def pocket(record: Record, a: str, name: str) -> Call:
    """Did a fall into this pocket?"""
    one = record.number(a)
    if not record.table.pockets:
        raise ValueError("this table has no pockets")
    if name not in POCKETS:
        raise ValueError(f"pockets are {', '.join(POCKETS)}; got {name!r}")
    centre = record.table.pocket_centres[POCKETS.index(name)]
    distance = np.linalg.norm(record.path[:, one] - centre, axis=1)
    if not np.isfinite(distance).any():
        raise ValueError(f"{a} was seen too seldom to be called")
    k = int(np.nanargmin(distance))
    margin, sigma = float(distance[k]) - MOUTH * record.table.ball_radius, float(record.path_sigma[k, one])
    events = record.events
    fell = [e for e in range(len(events)) if events.kind[e] == "pocket" and events.a[e] == a]
    here = [e for e in fell if events.b[e] == name]
    t, t_sigma = float(record.moments[k]), float("nan")
    probability = NEVER
    if here:
        t, t_sigma, probability = (float(v[here[-1]]) for v in (events.t, events.t_sigma, events.probability))
    probability = float(np.clip(probability, NEVER, ALWAYS))
    other = f"{a} fell into the {events.b[fell[-1]]} pocket" if fell else f"{a} stayed on the table"
    sentence = _told(probability, f"{a} fell into the {name} pocket", other)
    found = Moment(one, name, t, t_sigma, probability, margin, sigma)
    return _answer(record, found, probability, f"{sentence}; {_short(margin, sigma, 'the pocket')}", (a,))


def line(record: Record, a: str, axis: str, at: float, edge: bool) -> Call:
    """Did the centre of a (or its edge) cross the line `axis` = `at` (m)?"""
    one = record.number(a)
    if axis not in ("x", "y"):
        raise ValueError(f"a line is x=... or y=... in metres; got {axis!r}")
    along = record.path[:, one, "xy".index(axis)] - at
    there = np.flatnonzero(np.isfinite(along))
    if not len(there):
        raise ValueError(f"{a} was seen too seldom to be called")
    side = 1.0 if along[there[0]] > 0 else -1.0
    ahead = side * along - (record.table.ball_radius if edge else 0.0)  # > 0 while short of the line
    k = int(there[np.argmin(ahead[there])])
    margin, sigma = float(ahead[k]), float(max(record.path_sigma[k, one], 1e-5))
    probability = float(np.clip(ndtr(-margin / sigma), NEVER, ALWAYS))
    beyond = there[ahead[there] <= 0]
    when = int(beyond[0]) if len(beyond) else k
    pace = abs(float(record.velocity[when, one, "xy".index(axis)]))
    t_sigma = float(record.path_sigma[when, one]) / pace if len(beyond) and pace > RESTS else float("nan")
    what = f"{'the edge' if edge else 'the centre'} of {a}"
    sentence = _told(probability, f"{what} crossed {axis}={at:g} m", f"{what} did not cross {axis}={at:g} m")
    found = Moment(one, axis, float(record.moments[when]), t_sigma, probability, margin, sigma)
    return _answer(record, found, probability, f"{sentence}; {_short(margin, sigma, 'the line')}", (a,))


def _far_apart(record: Record, one: int, two: int) -> Call:
    """Two balls that never came near each other."""
    apart = np.linalg.norm(record.path[:, two] - record.path[:, one], axis=1) - 2 * record.table.ball_radius
    a, b = record.ids[one], record.ids[two]
    if not np.isfinite(apart).any():
        raise ValueError(f"{a} and {b} were never seen at the same time")
    k = int(np.nanargmin(apart))
    sigma = float(np.hypot(np.hypot(*record.path_sigma[k, [one, two]]), record.reach_sigma))
    found = Moment(one, b, float(record.moments[k]), float("nan"), NEVER, float(apart[k]), sigma)
    sentence = _told(NEVER, "", f"{a} and {b} did not touch")
    return _answer(record, found, NEVER, f"{sentence}; {_margin(found.gap, sigma)}", (a, b))


def _answer(record: Record, moment: Moment, probability: float, sentence: str, balls: tuple[str, ...]) -> Call:
    step = 2e-3
    moved = tuple(name for name in balls if record.speed(record.number(name), moment.t - step) > RESTS)
    when = f" at {moment.t:.4f} s"
    when += f" ± {1e3 * moment.t_sigma:.1f} ms" if np.isfinite(moment.t_sigma) else ""
    frame = record.frame_at(moment.t)
    movers = f"{' and '.join(moved)} moved" if moved else "nobody moved"
    full = f"{sentence}{when} (picture {frame:.2f}); just before, {movers}."
    return Call(probability, moment.t, moment.t_sigma, frame, moment.gap, moment.gap_sigma, full, moved, balls)


def _nowhere(probability: float, sentence: str, a: str) -> Call:
    """The call of something that has no moment."""
    nan = float("nan")
    return Call(probability, nan, nan, nan, nan, nan, f"{sentence}.", (), (a,))


def _told(probability: float, what: str, against: str) -> str:
    if probability > SURE:
        return f"Yes, with probability {probability:.1%}: {what}"
    if probability < 1 - SURE:
        return f"No, with probability {1 - probability:.1%}: {against}"
    return f"Inconclusive: the probability that {what} is {probability:.0%}"


def _likely(probability: float) -> str:
    """How an answer that is one of several begins."""
    return f"{'With' if probability > SURE else 'Inconclusive: with'} probability {probability:.1%}"


def _margin(gap: float, sigma: float) -> str:
    if not np.isfinite(gap):
        return "the gap is not known"
    word = "overlap" if gap < 0 else "pass each other"
    return f"free paths would {word} by {1e3 * abs(gap):.2f} ± {1e3 * sigma:.2f} mm"


def _short(margin: float, sigma: float, of: str) -> str:
    return f"{1e3 * abs(margin):.2f} ± {1e3 * sigma:.2f} mm {'short of' if margin > 0 else 'beyond'} {of}"
