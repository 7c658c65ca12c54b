"""Contacts that follow from one another within a picture: what hits what, foreseen roughly and put into a story.

A ball that runs into a row sends off the last of it, and those between hardly move: none of them breaks its path
where one can see it, so that contacts are proposed together, from the first on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_solution import Data
from models.estimation.segmentation.contact_graph import Contact, Story, after_merging
from models.physics.billiards.cloth.closed_form_motion import Friction, kinematics

RESTITUTION = 0.95
"""Ball against ball, 0.92 to 0.98 (Alciatore, TP A-6)."""
LONGEST_ROW = 8
"""contacts of one cascade: a longer one is too uncertain to be proposed."""
SLOW = 0.03
"""m/s: below, nothing is worth a contact."""
AROUND = 6
"""samples on either side that tell the velocities before and after."""
SHORTEST = 2e-4
"""s between two contacts of a ball."""


@dataclass(frozen=True, slots=True)
class Hit:
    """Balls a and b meet at t, s, and have states (6,) of place, velocity and slip after it."""

    t: float
    a: int
    b: int
    after_a: FloatArray
    after_b: FloatArray


def cascade(story: Story, friction: Friction, a: int, b: int, t: float, horizon: float, radius: float) -> list[Hit]:
    """What follows within `horizon` s, in order, if balls a and b meet at t; only the meeting where they part already.

    Balls go straight meanwhile; masses are equal. They come as if no change of velocity without a cause had happened
    within `horizon` of t: that is what the meeting explains.
    """
    balls = sorted({span.ball for span in story.spans})
    state = np.array([state_at(story, friction, _coming(story, ball, t, horizon), t) for ball in balls])
    i, j = balls.index(a), balls.index(b)
    hits: list[Hit] = []
    now = t
    while len(hits) < LONGEST_ROW:
        _collide(state, i, j)
        hits.append(Hit(now, balls[i], balls[j], state[i].copy(), state[j].copy()))
        wait, i, j = _next_pair(state[:, :2], state[:, 2:4], 2 * radius)
        now += max(wait, SHORTEST)
        if now - t > horizon:
            break
        state[:, :2] += max(wait, SHORTEST) * state[:, 2:4]
    return hits


def _collide(state: FloatArray, i: int, j: int) -> None:
    """Equal masses exchange velocity along the line of centres; the slip changes as the velocity does."""
    line = state[j, :2] - state[i, :2]
    line = line / max(float(np.hypot(*line)), 1e-9)
    push = (1 + RESTITUTION) / 2 * max(float((state[i, 2:4] - state[j, 2:4]) @ line), SLOW) * line
    for part in (slice(2, 4), slice(4, 6)):
        state[i, part] -= push
        state[j, part] += push


def _next_pair(x: FloatArray, v: FloatArray, reach: float) -> tuple[float, int, int]:
    """s until the next two balls of x (N, 2) m and v (N, 2) m/s meet, and which; those that overlap meet at once."""
    d, u = x[None] - x[:, None], v[None] - v[:, None]
    du, uu, dd = (d * u).sum(axis=2), (u * u).sum(axis=2), (d * d).sum(axis=2)
    root = du**2 - uu * np.maximum(dd - reach**2, 0.0)
    near = (du < -SLOW * np.sqrt(dd)) & (root >= 0)
    near[np.tril_indices(len(x))] = False
    if not near.any():
        return np.inf, 0, 0
    wait = np.where(
        near, np.maximum(dd - reach**2, 0.0) / np.where(near, -du + np.sqrt(np.maximum(root, 0)), 1), np.inf
    )
    i, j = divmod(int(np.argmin(wait)), len(x))
    return float(wait[i, j]), i, j


def with_hits(
    story: Story, friction: Friction, data: Data, owner: IntArray, hits: list[Hit], slack: float
) -> Story | None:
    """The story with all `hits`; None where it cannot take them.

    A change of velocity of a ball without a cause that is `slack` s near to its last hit becomes that hit. `owner` (K,)
    says which span of `story` each sample belongs to.
    """
    ends: dict[tuple[int, float], int] = {}  # contact numbers by ball and time
    for ball in sorted({hit.a for hit in hits} | {hit.b for hit in hits}):
        mine = [hit for hit in hits if ball in (hit.a, hit.b)]
        loose = loose_break(story, ball, mine[-1].t, slack)
        k = span_before(story, ball, mine[0].t) if loose is None else story.contacts[loose].before[0]
        cuts = mine if loose is None else mine[:-1]
        end = story.finish(k) if loose is None else mine[-1].t  # a loose change of velocity moves to where it belongs
        if any(not story.begin(k) + SHORTEST < hit.t < end for hit in cuts):
            return None
        if loose is None or len(mine) > 1:
            story = _shortened(story, data, owner, k, mine[0].t)
        for hit in cuts:
            after = hit.after_a if hit.a == ball else hit.after_b
            state = np.concatenate([after, np.zeros(2)])
            if loose is None and hit is mine[-1]:
                state = _as_seen(state, data, owner, k, hit.t)
            story = story.split(Contact("free", hit.t, (k,), ()), (state,))
            ends[ball, hit.t] = len(story.contacts) - 1
            k = len(story.spans) - 1
        if loose is not None:
            if not mine[-1].t < story.finish(story.contacts[loose].after[0]):
                return None
            ends[ball, mine[-1].t] = loose
    for hit in hits:
        keep, drop = sorted((ends[hit.a, hit.t], ends[hit.b, hit.t]))
        first, second = (story.contacts[ends[ball, hit.t]] for ball in (hit.a, hit.b))
        if first.before == second.before or all(story.spans[c.before[0]].static for c in (first, second)):
            return None
        joined = Contact("ball", hit.t, (*first.before, *second.before), (*first.after, *second.after))
        story = story.merged(keep, drop, replace(joined, gain=first.gain + second.gain))
        ends = {place: after_merging(number, keep, drop) for place, number in ends.items()}
    return story


def loose_break(story: Story, ball: int, t: float, slack: float) -> int | None:
    """The change of velocity of a ball, without a cause, that is nearest to t, if any within `slack`."""
    near = [
        (abs(c.t - t), number) for number, c in enumerate(story.contacts)
        if c.kind in ("free", "strike") and story.spans[c.before[0]].ball == ball and abs(c.t - t) < slack
    ]  # fmt: skip
    return min(near)[1] if near else None


def span_before(story: Story, ball: int, t: float) -> int:
    """The span of a ball that runs at t, s, or the first one."""
    spans = story.of_ball(ball)
    return next((k for k in reversed(spans) if story.begin(k) <= t), spans[0])


def _coming(story: Story, ball: int, t: float, slack: float) -> int:
    """The span in which a ball comes to a meeting at t, s."""
    loose = loose_break(story, ball, t, slack)
    return span_before(story, ball, t) if loose is None else story.contacts[loose].before[0]


def _shortened(story: Story, data: Data, owner: IntArray, k: int, t: float) -> Story:
    """Span k as its samples before t tell it, where these are few: the rest of them belongs to what follows."""
    rows = np.flatnonzero((owner == k) & (data.t < t))
    v = _slope(data, rows)
    if story.spans[k].static or v is None or len(rows) > AROUND:
        return story
    state = story.spans[k].state.copy()
    state[:2] = data.xy[rows].mean(axis=0) - v * (data.t[rows].mean() - story.begin(k))
    state[2:4], state[4:8] = v, 0.0
    spans = list(story.spans)
    spans[k] = replace(spans[k], state=state)
    return Story(tuple(spans), story.contacts)


def _as_seen(state: FloatArray, data: Data, owner: IntArray, k: int, t: float) -> FloatArray:
    """A foreseen state (8,) with the velocity that the samples of span k after t tell."""
    v = _slope(data, np.flatnonzero((owner == k) & (data.t >= t))[:AROUND])
    if v is None:
        return state
    seen = state.copy()
    seen[4:6] += v - seen[2:4]
    seen[2:4] = v
    return seen


def _slope(data: Data, rows: IntArray) -> FloatArray | None:
    """Velocity (2,) of a line through samples; None through fewer than two."""
    if len(rows) < 2:
        return None
    tau = data.t[rows] - data.t[rows].mean()
    v: FloatArray = tau @ (data.xy[rows] - data.xy[rows].mean(axis=0)) / (tau @ tau)
    return v


def state_at(story: Story, friction: Friction, k: int, t: float) -> FloatArray:
    """Position, velocity, slip (6,) of a span at t."""
    span = story.spans[k]
    if span.static:
        return np.concatenate([span.state[:2], np.zeros(4)])
    tau = np.array([max(t - story.begin(k), 0.0)])
    state: FloatArray = kinematics(span.state[None], tau, friction)[0]
    return state
