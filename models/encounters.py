"""Balls that came near each other: did they meet?

Wherever fitted paths pass within reach, a contact is tried: the spans around it are refined with and without it, and
it is kept where the samples and what is known of contacts pay for it. A change of velocity near by, that had no cause
or another one, becomes part of the contact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.billiards.motion import Friction, kinematics
from models.contacts import INWARD, NEAR_BALL
from models.refinement import refine
from models.scene import CUSHIONS, Table
from models.solution import Data, Solution, end_state, owners
from models.story import Contact, Story

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP = 2e-3
"""s between the moments at which distances are looked at; a ball at 5 m/s moves a third of its radius."""
NEAR_IN_TIME = 1.2
"""picture intervals: a change of velocity so near to a touch may be its effect."""
AROUND = 6
"""samples on either side that tell the velocities before and after."""
ITERATIONS = 12
SLOW = 0.03
"""m/s: below, nothing is worth a contact."""


@dataclass(frozen=True, slots=True)
class Pass:
    """Balls a and b come within reach of each other, nearest at t, s."""

    a: int
    b: int
    t: float


@dataclass(frozen=True, slots=True)
class _Trial:
    """A story with one contact more, and how much the region it changed gains in chi2, all prices paid."""

    one: Pass
    gain: float
    spans: frozenset[int]


def with_encounters(
    solution: Solution, data: Data, table: Table, price: float, dear: float, fresh: frozenset[int] | None = None
) -> tuple[Story, frozenset[int]]:
    """The story with the contacts of balls that pay for themselves, and the spans that changed.

    Only passes of `fresh` spans are tried where these are given.
    """
    interval = float(np.median(np.diff(np.unique(data.t))))
    owner = owners(solution.story, data)
    alone: dict[frozenset[int], float] = {}
    trials = []
    for one in near_passes(solution, data, table):
        trial = _tried(solution, data, owner, table, one, interval, (price, dear), alone, fresh)
        if trial is not None and trial.gain > 0:
            trials.append(trial)
    story, touched = solution.story, frozenset[int]()
    for trial in sorted(trials, key=lambda trial: -trial.gain):
        if trial.spans & touched:
            continue
        met = meet(story, solution.friction, data, owner, table, trial.one, interval)
        if met is not None:
            touched |= trial.spans | frozenset(range(len(story.spans), len(met.spans)))
            story = met
    return story.with_pushes(), touched


def near_passes(solution: Solution, data: Data, table: Table) -> list[Pass]:
    """Where two balls, one of them in motion, come within reach and no contact of the two is told."""
    story, interval = solution.story, float(np.median(np.diff(np.unique(data.t))))
    balls = np.unique(data.ball)
    t = np.arange(float(data.t.min()), float(data.t.max()), STEP)
    paths = {int(ball): _path(solution, data, int(ball), t) for ball in balls}
    changes = {int(ball): _changes(story, int(ball)) for ball in balls}
    reach = 2 * table.ball_radius * solution.diameter + NEAR_BALL * table.ball_radius
    found = []
    for i, a in enumerate(balls[:-1].tolist()):
        for b in balls[i + 1 :].tolist():
            moving = paths[a][1] | paths[b][1]
            apart = np.linalg.norm(paths[a][0] - paths[b][0], axis=1)
            within = np.nan_to_num(apart, nan=np.inf) < reach
            told = [c.t for c in story.contacts if c.kind == "ball" and _balls(story, c) == {a, b}]
            for first, end in _runs(within):
                rows = np.arange(first, end)[moving[first:end]]
                moments = [float(t[rows[np.argmin(apart[rows])]])] if len(rows) else []
                early, late = t[first] - interval, t[end - 1] + interval
                moments += [m for m in changes[a] + changes[b] if early < m < late]
                for moment in sorted(moments):
                    known = [m for m in told if abs(m - moment) < NEAR_IN_TIME * interval]
                    if not known:
                        told.append(moment)
                        found.append(Pass(a, b, moment))
    return found


def meet(
    story: Story, friction: Friction, data: Data, owner: Ints, table: Table, one: Pass, interval: float
) -> Story | None:
    """The story in which two balls meet; None where it cannot take that contact."""
    sides = [_side(story, ball, one.t, interval) for ball in (one.a, one.b)]
    if any(side is None for side in sides):
        return None
    spans, breaks = zip(*[side for side in sides if side is not None], strict=True)
    if all(story.spans[k].static for k in spans):
        return None
    known = [story.contacts[c].t for c in breaks if c is not None]
    t = float(np.mean(known)) if known else one.t
    moving = [k for k, c in zip(spans, breaks, strict=True) if c is None]
    if any(min(t - story.begin(k), story.finish(k) - t) < 1e-3 for k in moving):
        return None
    guesses = _guesses(story, friction, data, owner, table, spans, breaks, t)
    if guesses is None:
        return None
    numbers = []
    for k, c, (before, after) in zip(spans, breaks, guesses, strict=True):
        if c is None:
            story = story.split(Contact("free", t, (k,), ()), (after,))
            changed = list(story.spans)
            if before is not None:
                changed[k] = replace(changed[k], state=before)
            story = Story(tuple(changed), story.contacts)
        numbers.append(len(story.contacts) - 1 if c is None else c)
    keep, drop = numbers
    first, second = story.contacts[keep], story.contacts[drop]
    joined = Contact("ball", t, (*first.before, *second.before), (*first.after, *second.after))
    return story.merged(keep, drop, replace(joined, gain=first.gain + second.gain))


def doubtful(solution: Solution, contact: Contact) -> bool:
    """Contacts without a cause, and cushions and balls met so slowly that a bent path would do as well."""
    if contact.kind == "ball" and not contact.driven:
        return closing_speed(solution, contact) < SLOW
    if contact.kind == "cushion":
        return bool(-INWARD[CUSHIONS.index(contact.cushion)] @ end_state(solution, contact.before[0])[2:4] < SLOW)
    return contact.kind in ("free", "jump") or contact.pushed


def closing_speed(solution: Solution, contact: Contact) -> float:
    """Speed at which two balls come together, m/s."""
    one, two = (end_state(solution, k) for k in contact.before)
    apart = two[:2] - one[:2]
    return float((one[2:4] - two[2:4]) @ apart) / max(float(np.hypot(*apart)), 1e-9)


def _tried(
    solution: Solution, data: Data, owner: Ints, table: Table, one: Pass, interval: float,
    tolls: tuple[float, float], alone: dict[frozenset[int], float], fresh: frozenset[int] | None,
) -> _Trial | None:  # fmt: skip
    """What a contact gains where two balls pass; None where it cannot be."""
    story = solution.story
    met = meet(story, solution.friction, data, owner, table, one, interval)
    if met is None:
        return None
    contact = next(c for c in met.contacts if c.kind == "ball" and c not in story.contacts and _balls(met, c) ==
                   {one.a, one.b})  # fmt: skip
    region = frozenset(k for k in (*contact.before, *contact.after) if k < len(story.spans))
    if fresh is not None and not region & fresh:
        return None
    rows = np.isin(owner, list(region))
    local = Data(data.ball[rows], data.t[rows], data.xy[rows], data.whiten[rows])
    if not rows.any():
        return None
    if region not in alone:
        alone[region] = _cost(solution, story, sorted(region), local, table, tolls)
    new = sorted(region | frozenset(range(len(story.spans), len(met.spans))))
    return _Trial(one, alone[region] - _cost(solution, met, new, local, table, tolls), region)


def _cost(
    solution: Solution, story: Story, spans: list[int], local: Data, table: Table, tolls: tuple[float, float]
) -> float:
    """chi2 of some spans, refined by themselves, and the prices of the contacts among them."""
    part = refine(story.part(spans), local, table, iterations=ITERATIONS, start=solution)
    dear = sum(doubtful(part, c) for c in part.story.contacts)
    return part.chi2 + dear * tolls[1] + (len(part.story.contacts) - dear) * tolls[0]


def _path(solution: Solution, data: Data, ball: int, t: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Places (M, 2) of a ball, NaN where it was not followed, and whether it moves (M,)."""
    story = solution.story
    seen = data.t[data.ball == ball]
    spans = story.of_ball(ball)
    begins = np.array([story.begin(k) for k in spans])
    chosen = np.array(spans)[np.clip(np.searchsorted(begins, t, side="right") - 1, 0, None)]
    states = np.array([span.state for span in story.spans])[chosen]
    static = np.array([span.static for span in story.spans])[chosen]
    tau = np.maximum(t - np.array([story.begin(k) for k in range(len(story.spans))])[chosen], 0.0)
    path = kinematics(states, tau, solution.friction)
    xy = np.where(static[:, None], states[:, :2], path[:, :2])
    followed = (t >= seen[0]) & (t <= seen[-1])
    return np.where(followed[:, None], xy, np.nan), ~static & (np.linalg.norm(path[:, 2:4], axis=1) > SLOW)


def _changes(story: Story, ball: int) -> list[float]:
    """s: when a ball changes its velocity for no cause that is another ball or a cushion."""
    return [c.t for c in story.contacts if c.kind in ("free", "strike") and story.spans[c.before[0]].ball == ball]


def _balls(story: Story, contact: Contact) -> set[int]:
    return {story.spans[k].ball for k in contact.before}


def _runs(within: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], within.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _side(story: Story, ball: int, t: float, interval: float) -> tuple[int, int | None] | None:
    """The span of a ball that a contact at t ends, and the break without a cause that it explains, if any."""
    spans = story.of_ball(ball)
    k = next((k for k in reversed(spans) if story.begin(k) <= t), spans[0])
    ends = [story.spans[q].end for q in spans if story.spans[q].end is not None]
    loose = [c for c in ends if c is not None and story.contacts[c].kind in ("free", "strike")]
    loose = [c for c in loose if abs(story.contacts[c].t - t) < NEAR_IN_TIME * interval]
    if loose:
        c = min(loose, key=lambda c: abs(story.contacts[c].t - t))
        return story.contacts[c].before[0], c
    return (k, None) if story.begin(k) < t < story.finish(k) else None


def _guesses(
    story: Story, friction: Friction, data: Data, owner: Ints, table: Table,
    spans: tuple[int, ...], breaks: tuple[int | None, ...], t: float,
) -> list[tuple[Floats | None, Floats]] | None:  # fmt: skip
    """For each ball, the state (8,) of its span that a cut needs, None to leave it, and the state after the contact.

    Velocities are those of the samples on either side; where these are too few, of the path and an elastic contact.
    """
    at = [_at(story, friction, k, t) for k in spans]
    line = at[1][:2] - at[0][:2]
    line /= max(float(np.hypot(*line)), 1e-9)
    closing = float((at[0][2:4] - at[1][2:4]) @ line)
    found: list[tuple[Floats | None, Floats]] = []
    for sign, k, c, here in zip((-1.0, 1.0), spans, breaks, at, strict=True):
        after = np.concatenate([here, np.zeros(2)])
        if c is not None:
            found.append((None, after))
            continue
        rows = np.flatnonzero(owner == k)
        old, new = rows[data.t[rows] < t][-AROUND:], rows[data.t[rows] >= t][:AROUND]
        v = _slope(data, new)
        if v is None:
            v = here[2:4] + sign * max(closing, SLOW) * line
        change = v - here[2:4]
        after[2:4] = v
        after[4:6] = here[4:6] + change
        before = None
        if not story.spans[k].static and len(old) >= 2 and len(old) == len(rows[data.t[rows] < t]):
            before = _short(story, data, k, old)
        found.append((before, after))
    return found


def _short(story: Story, data: Data, k: int, rows: Ints) -> Floats | None:
    """State (8,) of span k whose samples are only `rows`: straight through them."""
    v = _slope(data, rows)
    if v is None:
        return None
    state = story.spans[k].state.copy()
    middle = data.xy[rows].mean(axis=0) - v * (data.t[rows].mean() - story.begin(k))
    state[:2], state[2:4], state[4:8] = middle, v, 0.0
    return state


def _slope(data: Data, rows: Ints) -> Floats | None:
    """Velocity (2,) of a line through samples."""
    if len(rows) < 2:
        return None
    tau = data.t[rows] - data.t[rows].mean()
    slope: Floats = tau @ (data.xy[rows] - data.xy[rows].mean(axis=0)) / (tau @ tau)
    return slope


def _at(story: Story, friction: Friction, k: int, t: float) -> Floats:
    """Position, velocity, slip (6,) of a span at t."""
    span = story.spans[k]
    if span.static:
        return np.concatenate([span.state[:2], np.zeros(4)])
    tau = np.array([max(t - story.begin(k), 0.0)])
    state: Floats = kinematics(span.state[None], tau, friction)[0]
    return state
