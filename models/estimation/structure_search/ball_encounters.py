"""Balls that came near each other: did they meet?

Wherever fitted paths pass within reach, a contact is tried: the spans around it are refined with and without it, and
it is kept where the samples and what is known of contacts pay for it. A change of velocity near by, that had no cause
or another one, becomes part of the contact.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.contact_cascades import SHORTEST, SLOW, Hit, cascade, loose_break, with_hits
from models.estimation.joint_fit.fit_solution import Data, Solution, end_state, owners, residuals
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.segmentation.contact_classification import INWARD, NEAR_BALL
from models.estimation.segmentation.contact_graph import Contact, Story
from models.physics.billiards.cloth.closed_form_motion import kinematics

STEP = 2e-3
"""s between the moments at which distances are looked at; a ball at 5 m/s moves a third of its radius."""
NEAR_IN_TIME = 1.2
"""picture intervals: a change of velocity so near to a touch may be its effect."""
ITERATIONS = 12


@dataclass(frozen=True, slots=True)
class Answers:
    """What is known already, by what was asked."""

    gains: dict[tuple[Hashable, ...], float] = field(default_factory=dict)
    """chi2 that contacts of a story improve."""
    trials: dict[tuple[Hashable, ...], tuple[float, Story]] = field(default_factory=dict)
    """chi2 that contacts more would gain, all prices paid, and the spans that they change, refined by themselves."""
    needed: set[tuple[Hashable, ...]] = field(default_factory=set)
    """Contacts that the whole clip has not let go nor had retold: who met, and when to a hundredth of a second."""


@dataclass(frozen=True, slots=True)
class Pass:
    """Balls a and b come within reach of each other, nearest at t, s."""

    a: int
    b: int
    t: float


@dataclass(frozen=True, slots=True)
class Encounter:
    """Contacts more, and how much the spans that they change gain in chi2, all prices paid."""

    hits: list[Hit]
    gain: float
    spans: frozenset[int]
    """Which of the story they change."""
    part: Story
    """These, in order, and the new ones, refined by themselves."""


def encounters(
    solution: Solution, data: Data, table: Table, tolls: tuple[float, float], asked: Answers,
    fresh: frozenset[int] | None = None,
) -> list[Encounter]:  # fmt: skip
    """Contacts of balls that pay for themselves where they happen, the best first.

    `tolls` are the prices of contacts with a cause and without; `asked` keeps what was tried, so that it is not tried
    again while nothing changes. Only passes of `fresh` spans are tried where these are given.
    """
    interval, owner = interval_of(data), owners(solution.story, data)
    alone: dict[frozenset[int], float] = {}
    trials = []
    slack = NEAR_IN_TIME * interval
    for one in near_passes(solution, data, table):
        for hits in _proposals(solution, table, one, interval):
            met = with_hits(solution.story, solution.friction, data, owner, hits, slack)
            trial = None if met is None else _tried(solution, data, owner, table, met, hits, tolls, alone, asked, fresh)
            if trial is not None and trial.gain > 0:
                trials.append(trial)
    return sorted(trials, key=lambda trial: -trial.gain)


def with_encounters(
    solution: Solution, data: Data, chosen: list[Encounter], slack: float
) -> tuple[Story, frozenset[int]]:
    """The story with these contacts, as far as none disturbs a better one, and the spans that changed."""
    story, touched, owner = solution.story, frozenset[int](), owners(solution.story, data)
    for one in chosen:
        if one.spans & touched:
            continue
        met = with_hits(story, solution.friction, data, owner, one.hits, slack)
        if met is not None:
            new = range(len(story.spans), len(met.spans))
            touched |= one.spans | frozenset(new)
            story = as_refined(met, one.part, [*sorted(one.spans), *new])
    return story.with_pushes(), touched


def as_refined(story: Story, part: Story, spans: list[int]) -> Story:
    """The story with states and times of a refined part of it, which are its `spans`; as it is if they do not fit."""
    states, contacts = list(story.spans), list(story.contacts)
    for k, refined in zip(spans, part.spans, strict=True):
        if states[k].static == refined.static:
            states[k] = replace(states[k], state=refined.state)
    for contact in part.contacts:
        number = states[spans[contact.before[0]]].end
        if number is not None:
            contacts[number] = replace(contacts[number], t=contact.t)
    fresh = Story(tuple(states), tuple(contacts))
    lasts = all(fresh.finish(k) > fresh.begin(k) + SHORTEST for k in range(len(states)))
    return fresh if lasts else story


def near_passes(solution: Solution, data: Data, table: Table) -> list[Pass]:
    """Where two balls, one of them in motion, come within reach and no contact of the two is told."""
    story, interval = solution.story, interval_of(data)
    balls = np.unique(data.ball)
    t = np.arange(float(data.t.min()), float(data.t.max()), STEP)
    miss = residuals(solution, data)
    paths = {int(ball): _path(solution, data, miss, int(ball), t) for ball in balls}
    changes = {int(ball): _changes(story, int(ball)) for ball in balls}
    reach = 2 * table.ball_radius * solution.diameter + NEAR_BALL * table.ball_radius
    found = []
    for i, a in enumerate(balls[:-1].tolist()):
        for b in balls[i + 1 :].tolist():
            moving = paths[a][1] | paths[b][1]
            apart = np.linalg.norm(paths[a][0] - paths[b][0], axis=1)
            within = np.nan_to_num(apart, nan=np.inf) < reach
            told = [c.t for c in story.contacts if c.kind == "ball" and story.balls_at(c) == {a, b}]
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


def _proposals(solution: Solution, table: Table, one: Pass, interval: float) -> list[list[Hit]]:
    """The meeting of two balls alone; and the cascade that it sends off, if it does."""
    story, radius = solution.story, table.ball_radius * solution.diameter
    near = (loose_break(story, ball, one.t, NEAR_IN_TIME * interval) for ball in (one.a, one.b))
    known = [story.contacts[c].t for c in near if c is not None]
    t = float(np.mean(known)) if known else one.t
    hits = cascade(story, solution.friction, one.a, one.b, t, interval, radius)
    return [hits[:1], hits] if len(hits) > 1 else [hits]


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
    solution: Solution, data: Data, owner: IntArray, table: Table, met: Story, hits: list[Hit],
    tolls: tuple[float, float], alone: dict[frozenset[int], float], asked: Answers, fresh: frozenset[int] | None,
) -> Encounter | None:  # fmt: skip
    """What a story gains over that of the solution where they differ; None where only old spans are concerned."""
    story = solution.story
    new = frozenset(range(len(story.spans), len(met.spans)))
    moments = {hit.t for hit in hits}
    changed = [c for c in met.contacts if c.kind == "ball" and c.t in moments]
    region = frozenset(k for c in changed for k in (*c.before, *c.after)) - new
    rows = np.isin(owner, list(region))
    if not rows.any() or (fresh is not None and not region & fresh):
        return None
    question = (len(hits), *met.told(sorted(region | new)))
    if question not in asked.trials:
        local = Data(data.ball[rows], data.t[rows], data.xy[rows], data.whiten[rows])
        if region not in alone:
            alone[region] = total_cost(refined_part(solution, story, sorted(region), local, table), tolls)
        part = refined_part(solution, met, sorted(region | new), local, table)
        asked.trials[question] = alone[region] - total_cost(part, tolls), part.story
    return Encounter(hits, asked.trials[question][0], region, asked.trials[question][1])


def refined_part(solution: Solution, story: Story, spans: list[int], local: Data, table: Table) -> Solution:
    """Some spans of a story and the contacts among them, refined by themselves."""
    return refine(story.part(spans), local, table, iterations=ITERATIONS, start=solution)


def total_cost(solution: Solution, tolls: tuple[float, float]) -> float:
    """chi2 of a solution and the prices of its contacts."""
    dear = sum(doubtful(solution, c) for c in solution.story.contacts)
    return solution.chi2 + dear * tolls[1] + (len(solution.story.contacts) - dear) * tolls[0]


def interval_of(data: Data) -> float:
    """s between two pictures."""
    return float(np.median(np.diff(np.unique(data.t))))


def _path(
    solution: Solution, data: Data, miss: FloatArray, ball: int, t: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Places (M, 2) of a ball, NaN where it was not followed, and whether it moves (M,).

    The fitted path, drawn to the samples by what it misses, `miss` (K, 2) m: it is wrong where a contact is wanting.
    """
    story, mine = solution.story, data.ball == ball
    seen = data.t[mine]
    spans = story.of_ball(ball)
    begins = np.array([story.begin(k) for k in spans])
    chosen = np.array(spans)[np.clip(np.searchsorted(begins, t, side="right") - 1, 0, None)]
    states = np.array([span.state for span in story.spans])[chosen]
    static = np.array([span.static for span in story.spans])[chosen]
    tau = np.maximum(t - np.array([story.begin(k) for k in range(len(story.spans))])[chosen], 0.0)
    path = kinematics(states, tau, solution.friction)
    xy = np.where(static[:, None], states[:, :2], path[:, :2])
    xy = xy + np.stack([np.interp(t, seen, miss[mine, axis]) for axis in (0, 1)], axis=1)
    followed = (t >= seen[0]) & (t <= seen[-1])
    return np.where(followed[:, None], xy, np.nan), ~static & (np.linalg.norm(path[:, 2:4], axis=1) > SLOW)


def _changes(story: Story, ball: int) -> list[float]:
    """s: when a ball changes its velocity for no cause that is another ball or a cushion."""
    return [c.t for c in story.contacts if c.kind in ("free", "strike") and story.spans[c.before[0]].ball == ball]


def _runs(within: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], within.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
