"""What broke the path of a ball: a cue, another ball, a cushion, or nothing that is known."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.segmentation.contact_graph import Contact, ContactKind, Span, Story
from models.estimation.segmentation.jitter_removal import STILL, curve_of, part_of
from models.estimation.segmentation.track_segmentation import Samples, Segment, SpanStart, fit_span

NEAR_CUSHION = 0.6
"""ball radii: a centre may be so far from where it should touch (calibration, cloth edge, soft rubber)."""
NEAR_BALL = 0.45
"""ball radii: the same for the distance of two balls."""
JUMP = 0.4
"""ball radii: curves that pass each other by more do not belong to one motion."""
CUE_KINDS = ("cue", "white", "yellow")
"""Balls that a cue may strike, where a strike has to be attributed."""


@dataclass(frozen=True, slots=True)
class Break:
    """A change of velocity of one ball, between two of its samples."""

    ball: int
    left: int
    """Index of the segment before, within the ball."""
    t: float
    early: float
    late: float
    """s: times of the samples before and after."""
    x: FloatArray
    before: FloatArray
    after: FloatArray
    """(2,) m and m/s."""
    from_rest: bool
    gain: float
    left_curve: SpanStart
    right_curve: SpanStart
    jump: bool
    """The curves before and after do not meet."""

    @property
    def change(self) -> FloatArray:
        """Of the velocity, (2,) m/s."""
        return self.after - self.before


@dataclass(frozen=True, slots=True)
class _Cause:
    score: float
    kind: ContactKind
    breaks: tuple[int, ...]
    cushion: str = ""


def cushion_distances(x: FloatArray, table: Table) -> FloatArray:
    """From points (..., 2) to the four noses (..., 4), in the order of `CUSHIONS`, m."""
    return np.stack([x[..., 0], table.length - x[..., 0], x[..., 1], table.width - x[..., 1]], axis=-1)


INWARD = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
"""Normals (4, 2) of the noses, into the table."""


def breaks_of(ball: int, samples: Samples, segments: list[Segment], radius: float) -> list[Break]:
    """Times, places and velocities at the breaks between segments."""
    fits = [curve_of(samples, part) for part in segments]
    found: list[Break] = []
    for k, (one, two) in enumerate(pairwise(fits)):
        last, first = segments[k].last, segments[k + 1].first
        early, late = float(samples.t[last]), float(samples.t[first])
        t_best, x = _meeting(samples, segments[k], segments[k + 1], one, two)
        if found and t_best < found[-1].t + 0.1 * (late - early):
            t_best = found[-1].t + 0.1 * (late - early)
        apart = float(np.linalg.norm(one.at(t_best) - two.at(t_best)))
        sure = _certain(segments[k]) and _certain(segments[k + 1])
        jump = sure and apart > JUMP * radius + 5 * float(np.median(samples.sigma))
        whole = part_of(samples, Segment(segments[k].first, segments[k + 1].last, False))
        gain = fit_span(whole, float(whole.t[0])).chi2 - one.chi2 - two.chi2
        before = np.zeros(2) if segments[k].static else _velocity(samples, segments, k, one, t_best)
        after = np.zeros(2) if segments[k + 1].static else _velocity(samples, segments, k + 1, two, t_best)
        found.append(Break(ball, k, t_best, early, late, x, before, after, segments[k].static, gain, one, two, jump))
    return found


def explain(breaks: list[Break], table: Table) -> list[_Cause]:
    """The most plausible causes, each break in at most one of them; what is left over is `strike` or `free`."""
    causes = _pairs(breaks, table) + _cushions(breaks, table)
    used: set[int] = set()
    chosen = []
    for cause in sorted(causes, key=lambda c: c.score):
        if not used & set(cause.breaks):
            used |= set(cause.breaks)
            chosen.append(cause)
    for k, one in enumerate(breaks):
        if k not in used:
            kind: ContactKind = "strike" if one.from_rest else "jump" if one.jump else "free"
            chosen.append(_Cause(0.0, kind, (k,)))
    return chosen


def near_something(samples: Samples, others: list[Samples], table: Table) -> NDArray[np.bool_]:
    """(n-1,) between which samples of a ball a cushion or another ball may have changed its velocity, or a cue did."""
    step = np.linalg.norm(np.diff(samples.xy, axis=0), axis=1)
    ends = np.stack([samples.xy[:-1], samples.xy[1:]])  # (2, n-1, 2)
    slack = NEAR_CUSHION * table.ball_radius + 0.6 * step
    near = (cushion_distances(ends, table).min(axis=(0, 2)) - table.ball_radius) < slack
    resting = np.ones(len(step), bool)
    resting[1:] = step[:-1] < STILL * table.ball_radius
    near |= resting & (step > STILL * table.ball_radius)
    middle = (samples.t[1:] + samples.t[:-1]) / 2
    for other in others:
        if len(other.t) < 2:
            continue
        there = np.stack([np.interp(middle, other.t, other.xy[:, k]) for k in (0, 1)], axis=1)
        pace = np.interp(middle, (other.t[1:] + other.t[:-1]) / 2, np.linalg.norm(np.diff(other.xy, axis=0), axis=1))
        reach = (2 + 2 * NEAR_BALL) * table.ball_radius + 0.8 * (step + pace)
        near |= np.linalg.norm(ends.mean(axis=0) - there, axis=1) < reach
    known: NDArray[np.bool_] = near
    return known


def _pairs(breaks: list[Break], table: Table) -> list[_Cause]:
    causes = []
    for i, one in enumerate(breaks):
        for j in range(i + 1, len(breaks)):
            two = breaks[j]
            if one.ball == two.ball or not _overlap(one, two):
                continue
            if one.from_rest and two.from_rest and _met_by_a_third(one, two, breaks, table.ball_radius):
                continue  # what came hit one of them, and that one perhaps the other
            score = _pair_score(one, two, table.ball_radius)
            if np.isfinite(score):
                causes.append(_Cause(score, "ball", (i, j)))
    return causes


def _met_by_a_third(one: Break, two: Break, breaks: list[Break], radius: float) -> bool:
    """Whether a ball that was in motion turns beside one of two that begin to move: then it has met that one."""
    for third in breaks:
        if third.from_rest or third.ball in (one.ball, two.ball):
            continue
        reach = 2 * (1 + NEAR_BALL) * radius + 0.5 * float(np.linalg.norm(third.before)) * (third.late - third.early)
        for other in (one, two):
            if _overlap(third, other) and np.linalg.norm(third.x - other.x) < reach:
                return True
    return False


def _overlap(one: Break, two: Break) -> bool:
    """Whether two breaks may be one moment."""
    if one.early > two.late + 0.7 * (two.late - two.early):
        return False
    return two.early <= one.late + 0.7 * (one.late - one.early)


def _pair_score(one: Break, two: Break, radius: float) -> float:
    """Below about 2 where two breaks are one contact; infinite where they cannot be."""
    window = max(one.late - one.early, two.late - two.early)
    relative = float(np.linalg.norm(one.before - two.before))
    tolerance = NEAR_BALL * radius + 0.5 * relative * min(one.late - one.early, two.late - two.early)
    apart = _apart(one, two, 2 * radius)
    distance = float(np.hypot(*apart))
    normal = apart / max(distance, 1e-9)
    miss = abs(distance - 2 * radius) / tolerance
    total = np.linalg.norm(one.change) + np.linalg.norm(two.change)
    momentum = float(np.linalg.norm(one.change + two.change)) / max(float(total), 1e-6)
    separating = (two.after - one.after) @ normal
    late = abs(one.t - two.t) / window
    if miss > 1 or (momentum > 0.75 and not (one.from_rest and two.from_rest)) or separating < -0.3 * relative - 0.05:
        return np.inf
    return miss + momentum + 0.3 * late - 0.5


def _apart(one: Break, two: Break, reach: float) -> FloatArray:
    """From ball to ball (2,) at the moment that the better seen of two breaks tells; nearest to `reach` m.

    A ball that was lost for some pictures may have met the other at any time meanwhile.
    """
    t = one.t if one.late - one.early <= two.late - two.early else two.t
    places = [[b.x, b.left_curve.at(t), b.right_curve.at(t)] for b in (one, two)]
    apart = np.array([b - a for a in places[0] for b in places[1]])
    nearest: FloatArray = apart[np.argmin(np.abs(np.linalg.norm(apart, axis=1) - reach))]
    return nearest


def _cushions(breaks: list[Break], table: Table) -> list[_Cause]:
    causes = []
    for k, one in enumerate(breaks):
        distance = cushion_distances(one.x, table) - table.ball_radius
        towards, away = -INWARD @ one.before, INWARD @ one.after
        speed = np.linalg.norm(one.before)
        tolerance = NEAR_CUSHION * table.ball_radius + 0.35 * speed * (one.late - one.early)
        for side in range(4):
            along = abs(np.array([-INWARD[side, 1], INWARD[side, 0]]) @ one.change)
            across = abs(INWARD[side] @ one.change)
            if abs(distance[side]) < tolerance and towards[side] > 0.01 and away[side] > -0.2 * towards[side]:
                score = abs(distance[side]) / tolerance + along / (along + across + 1e-9) - 0.2
                causes.append(_Cause(float(score), "cushion", (k,), CUSHIONS[side]))
    return causes


def tell(samples: list[Samples], segments: list[list[Segment]], table: Table, kinds: tuple[str, ...]) -> Story:
    """First story of a clip: spans of every ball, joined by the contacts that explain their breaks."""
    spans: list[Span] = []
    index: dict[tuple[int, int], int] = {}
    breaks: list[Break] = []
    for ball, (seen, parts) in enumerate(zip(samples, segments, strict=True)):
        for k, part in enumerate(parts):
            index[ball, k] = len(spans)
            spans.append(_span(ball, seen, part))
        breaks += breaks_of(ball, seen, parts, table.ball_radius) if parts else []
    contacts: list[Contact] = []
    unseen: dict[int, Break] = {}
    for cause in explain(breaks, table):
        members = [breaks[k] for k in cause.breaks]
        before = tuple(index[b.ball, b.left] for b in members)
        after = tuple(index[b.ball, b.left + 1] for b in members)
        t = (
            float(min(members, key=lambda b: b.late - b.early).t)
            if len({b.late - b.early for b in members}) > 1
            else float(np.mean([b.t for b in members]))
        )
        contact = Contact(cause.kind, t, before, after, cause.cushion, gain=sum(b.gain for b in members))
        for b, one, two in zip(members, before, after, strict=True):
            spans[one] = _ending(spans[one], len(contacts))
            fresh = _span(b.ball, samples[b.ball], segments[b.ball][b.left + 1], t, b)
            spans[two] = Span(fresh.ball, fresh.static, len(contacts), spans[two].end, t, fresh.state)
        if cause.kind == "strike" and members[0].jump:
            unseen[len(contacts)] = members[0]
        contacts.append(contact)
    story = _with_runs(Story(tuple(spans), tuple(contacts)), unseen)
    return _with_strikes(story, samples, table, kinds)


def _with_runs(story: Story, unseen: dict[int, Break]) -> Story:
    """Balls that rested, were lost, and came back elsewhere ran there meanwhile: struck, then stopped by something."""
    spans, contacts = list(story.spans), list(story.contacts)
    for number, gap in unseen.items():
        strike = contacts[number]
        rest, goal = strike.before[0], strike.after[0]
        margin = 0.2 * (gap.late - gap.early)
        start, stop = gap.early + margin, gap.late - margin
        there = gap.right_curve.at(stop)
        v = (there - spans[rest].state[:2]) / (stop - start)
        run = Span(
            gap.ball,
            False,
            number,
            len(contacts),
            start,
            np.concatenate([spans[rest].state[:2], v, 0.1 * v, np.zeros(2)]),
        )
        arrived = spans[goal].state.copy()
        arrived[:2] = there
        arrived[2:4] = 0.0 if spans[goal].static else gap.right_curve.velocity(stop)
        spans[goal] = Span(gap.ball, spans[goal].static, len(contacts), spans[goal].end, stop, arrived)
        contacts[number] = Contact("strike", start, (rest,), (len(spans),), gain=strike.gain)
        contacts.append(Contact("free", stop, (len(spans),), (goal,), gain=strike.gain))
        spans.append(run)
    return Story(tuple(spans), tuple(contacts))


def _with_strikes(story: Story, samples: list[Samples], table: Table, kinds: tuple[str, ...]) -> Story:
    """Where two resting balls part from each other, one of them was struck just before."""
    spans, contacts = list(story.spans), list(story.contacts)
    for number, contact in enumerate(story.contacts):
        if contact.kind != "ball" or not all(_waits(spans, samples, contact, side, table) for side in (0, 1)):
            continue
        cue = _struck(spans, contact, kinds)
        other = 1 - cue
        rest, goal = spans[contact.before[cue]].state[:2], spans[contact.before[other]].state[:2]
        way = goal - rest
        gap = float(np.hypot(*way)) - 2 * table.ball_radius
        v = spans[contact.after[0]].state[2:4] + spans[contact.after[1]].state[2:4]
        speed = max(float(v @ way) / float(np.hypot(*way)), 0.1)
        if gap < 0.15 * table.ball_radius or _while_others_move(story, contact):
            contacts[number] = Contact("ball", contact.t, contact.before, contact.after, driven=True, gain=contact.gain)
            continue
        old = contact.before[cue]
        t = max(contact.t - gap / speed, (spans[old].t0 + contact.t) / 2)
        state = np.concatenate([rest, v, np.zeros(4)])
        spans.append(Span(spans[old].ball, False, len(contacts), number, t, state))
        still = np.concatenate([rest, np.zeros(6)])
        spans[old] = Span(
            spans[old].ball,
            True,
            None if not spans[old].static else spans[old].start,
            len(contacts),
            spans[old].t0,
            still,
        )
        before = tuple(len(spans) - 1 if k == cue else contact.before[k] for k in range(2))
        contacts[number] = Contact("ball", contact.t, before, contact.after, gain=contact.gain)
        contacts.append(Contact("strike", t, (old,), (len(spans) - 1,), gain=contact.gain))
    return Story(tuple(spans), tuple(contacts))


def _while_others_move(story: Story, contact: Contact) -> bool:
    """Whether a third ball moves when two part from each other: then it sent them off, for no cue strikes meanwhile."""
    pair = story.balls_at(contact)
    return any(
        not span.static and span.ball not in pair and story.begin(k) < contact.t < story.finish(k)
        for k, span in enumerate(story.spans)
    )


def _waits(spans: list[Span], samples: list[Samples], contact: Contact, side: int, table: Table) -> bool:
    """Whether a ball rests, or is seen to move too little to come to the other one by itself."""
    span, other = spans[contact.before[side]], spans[contact.after[1 - side]]
    if span.static:
        return True
    gap = np.linalg.norm(other.state[:2] - span.state[:2]) - 2 * table.ball_radius
    seen = samples[span.ball]
    rows = np.flatnonzero((seen.t >= span.t0) & (seen.t < contact.t))
    went = float(np.linalg.norm(seen.xy[rows[-1]] - seen.xy[rows[0]])) if len(rows) else 0.0
    way = max(went, float(np.linalg.norm(span.state[2:4])) * (contact.t - span.t0))
    return bool(span.start is None and way < 0.5 * gap)


def _struck(spans: list[Span], contact: Contact, kinds: tuple[str, ...]) -> int:
    """Which of two balls (0 or 1) the cue met: by its kind, else the one that left less along the line of centres."""
    named = [kinds[spans[k].ball] in CUE_KINDS for k in contact.before]
    if named[0] != named[1]:
        return 0 if named[0] else 1
    line = spans[contact.before[1]].state[:2] - spans[contact.before[0]].state[:2]
    line /= np.hypot(*line)
    straight = []
    for k, sign in zip(contact.after, (-1, 1), strict=True):
        v = spans[k].state[2:4]
        straight.append(sign * float(v @ line) / max(float(np.hypot(*v)), 1e-6))
    return int(np.argmin(straight))


def _ending(span: Span, contact: int) -> Span:
    return Span(span.ball, span.static, span.start, contact, span.t0, span.state)


def _span(ball: int, samples: Samples, part: Segment, t: float | None = None, start: Break | None = None) -> Span:
    """A span with its state at time t, the time of its first sample by default."""
    seen = part_of(samples, part)
    begin = float(seen.t[0]) if t is None else t
    if part.static:
        return Span(ball, True, None, None, begin, np.concatenate([np.median(seen.xy, axis=0), np.zeros(6)]))
    if start is not None and part.last - part.first < 2:
        state = np.concatenate([start.x, start.after, np.zeros(4)])
        return Span(ball, False, None, None, begin, state)
    fit = fit_span(seen, begin)
    return Span(ball, False, None, None, begin, np.concatenate([fit.x, fit.v, fit.slip, np.zeros(2)]))


def _meeting(
    samples: Samples, left: Segment, right: Segment, one: SpanStart, two: SpanStart
) -> tuple[float, FloatArray]:
    """When and where two successive curves meet: near the gap between their samples, at their closest approach."""
    early, late = float(samples.t[left.last]), float(samples.t[right.first])
    slack = min(0.3 * (late - early), 0.5 * _interval(samples))
    t = np.linspace(early - slack, late + slack, 60)
    best = float(t[np.argmin(np.linalg.norm(one.at(t) - two.at(t), axis=1))])
    best = max(best, float(samples.t[left.first]) + 0.1 * (late - early))
    known = [part.static or part.last - part.first >= 1 for part in (left, right)]
    if known[0] == known[1]:
        return best, (one.at(best) + two.at(best)) / 2
    # a curve through one sample is no curve: trust the other side
    middle = (early + late) / 2
    return middle, (one if known[0] else two).at(middle)


def _certain(part: Segment) -> bool:
    """Whether a segment has samples enough for a curve."""
    return part.static or part.last - part.first >= 2


def _interval(samples: Samples) -> float:
    """Typical time between samples, s."""
    return float(np.median(np.diff(samples.t)))


def _velocity(samples: Samples, segments: list[Segment], k: int, fit: SpanStart, t: float) -> FloatArray:
    """From the fit; from the neighbours' samples where the segment itself has only one."""
    part = segments[k]
    if part.last > part.first:
        return fit.velocity(t)
    before, after = max(part.first - 1, 0), min(part.last + 1, len(samples.t) - 1)
    mean: FloatArray = (samples.xy[after] - samples.xy[before]) / (samples.t[after] - samples.t[before])
    return mean
