"""Balls that lie together and are hit, found in a refined story: what has to be known to play what follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.break_shot.break_data import Burst
from models.estimation.joint_fit.contact_cascades import span_before
from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.segmentation.contact_graph import Story
from models.estimation.structure_search.ball_encounters import interval_of
from models.physics.billiards.cloth.closed_form_motion import kinematics
from models.tracking.track_noise import FLOOR

FEWEST, FEWEST_LEAVE = 4, 3
"""balls that lie together, and that set off at once: contacts of fewer are told one by one."""
TOGETHER = 0.25
"""ball radii between two surfaces: nearer ones lie together."""
AT_ONCE = 3.0
"""pictures within which balls of a rack set off."""
LOOKED_BACK = 0.5
"""s for which the coming ball is followed."""
WAY, LEAST_PICTURES, LONGEST = 30.0, 4.0, 0.5
"""Ball radii that the coming ball would go on, at least so many pictures, at most so many s: how long the balls are
watched after the hit."""
ENOUGH = 3
"""Samples that tell the path of a ball by themselves."""
_PLACE_SIGMA, _SPEED_SIGMA = 5e-3, 0.15
"""m, and of its speed: of a coming ball that was seen less often."""
_UNSEEN = 0.3
"""ball radii: of the place of a ball that rests unseen."""
_LATEST, _RESTS = 5, 10.0
"""samples before the burst, of which the median chi2 says whether a ball still rests; single bad ones do not."""
_JAWS = 3.0
"""ball radii around a pocket, where nothing is played."""


@dataclass(frozen=True, slots=True)
class _Lying:
    """A ball that rests until the burst, whatever the story has it do shortly before."""

    ball: int
    place: FloatArray
    """(2,) m."""
    sigma: float
    """m per axis."""


def racks(solution: Solution, data: Data, table: Table) -> list[Burst]:
    """All bursts of a clip in the order of time, as their samples have them."""
    story = solution.story
    leave = sorted(
        (story.contacts[span.end].t, k) for k, span in enumerate(story.spans) if span.static and span.end is not None
    )
    if len(leave) < FEWEST_LEAVE:
        return []
    found: list[Burst] = []
    interval, after = interval_of(data), -np.inf
    for first, _ in leave:
        leaving = {story.spans[k].ball for t, k in leave if first <= t <= first + AT_ONCE * interval}
        if first < after or len(leaving) < FEWEST_LEAVE:
            continue
        lying = _lying(solution, data, first, table)
        rack = _together(lying, leaving, (2 * solution.diameter + TOGETHER) * table.ball_radius)
        coming = _coming(solution, rack, first, AT_ONCE * interval, table) if rack else None
        burst = _seen(solution, data, table, *coming, lying, interval) if coming else None
        if burst is not None:
            found.append(burst)
            after = burst.ends
    return found


def _lying(solution: Solution, data: Data, t: float, table: Table) -> list[_Lying]:
    """Balls that rest until t, as their samples before it say; where paths begin is told badly by contacts at once."""
    story, found = solution.story, []
    for ball in sorted({span.ball for span in story.spans}):
        begin = rests_from(story, ball, t)
        rows = np.flatnonzero((data.ball == ball) & (data.t >= begin) & (data.t < t))
        if len(rows):
            place, sigma, rests = _rest(data, rows)
        else:
            k = span_before(story, ball, t)
            place, sigma, rests = story.spans[k].state[:2].copy(), _UNSEEN * table.ball_radius, story.spans[k].static
        if rests:
            found.append(_Lying(ball, place, float(np.hypot(sigma, FLOOR * table.ball_radius))))
    return found


def rests_from(story: Story, ball: int, t: float) -> float:
    """s, from when on a ball rests that lies somewhere at t: the beginning of its rest in the story, or a while."""
    resting = [k for k in story.of_ball(ball) if story.spans[k].static and story.begin(k) < t]
    if resting and story.finish(resting[-1]) > t - LOOKED_BACK:
        return min(story.begin(resting[-1]), t)
    return max(story.begin(span_before(story, ball, t - LOOKED_BACK)), t - LOOKED_BACK)


def _rest(data: Data, rows: IntArray) -> tuple[FloatArray, float, bool]:
    """Where samples of one place say it is, (2,) m, its standard deviation, m per axis, and whether they agree."""
    known = np.einsum("kij,kil->kjl", data.whiten[rows], data.whiten[rows])
    covariance = np.linalg.inv(known.sum(axis=0))
    place = covariance @ np.einsum("kij,kj->i", known, data.xy[rows])
    size = (np.einsum("kij,kj->ki", data.whiten[rows], data.xy[rows] - place) ** 2).sum(axis=1)
    return place, float(np.sqrt(np.trace(covariance) / 2)), float(np.median(size[-_LATEST:])) < _RESTS


def _together(lying: list[_Lying], leaving: set[int], reach: float) -> list[_Lying]:
    """Balls that lie together, of those groups from which enough of the balls `leaving` go."""
    places = np.array([one.place for one in lying]).reshape(-1, 2)
    near = np.linalg.norm(places[:, None] - places, axis=2) < reach
    group = _groups(near)
    found: list[_Lying] = []
    for number in np.unique(group):
        members = [lying[k] for k in np.flatnonzero(group == number)]
        if len(members) >= FEWEST and len({one.ball for one in members} & leaving) >= FEWEST_LEAVE:
            found += members
    return found


def _groups(near: NDArray[np.bool_]) -> IntArray:
    """(n,) the first of all that each hangs together with, by way of pairs (n, n) that are near each other."""
    linked = near | np.eye(len(near), dtype=np.bool_)
    while not np.array_equal(linked, further := linked @ linked):
        linked = further
    return np.array([np.flatnonzero(row)[0] for row in linked], dtype=np.int64)


def _coming(
    solution: Solution, rack: list[_Lying], t: float, slack: float, table: Table
) -> tuple[int, float] | None:  # fmt: skip
    """The span of the first ball whose path, followed on, meets one of the rack within `slack` s of t, and when."""
    story, radius = solution.story, table.ball_radius * solution.diameter
    places, members = np.array([one.place for one in rack]), {one.ball for one in rack}
    found: list[tuple[float, int]] = []
    for k, span in enumerate(story.spans):
        begin = story.begin(k)
        if span.static or span.ball in members or begin > t or story.finish(k) < t - slack:
            continue
        times = np.linspace(max(begin, t - slack), t + slack, 400)
        path = kinematics(np.repeat(span.state[None], len(times), axis=0), times - begin, solution.friction)
        touching = np.linalg.norm(path[:, None, :2] - places, axis=2).min(axis=1) <= 2 * radius
        if touching.any() and not touching[0]:
            found.append((float(times[np.argmax(touching)]), k))
    return (min(found)[1], min(found)[0]) if found else None


def _seen(
    solution: Solution, data: Data, table: Table, come: int, hit: float, lying: list[_Lying], interval: float
) -> Burst | None:
    """What was seen of a burst, the span `come` being that of the coming ball; None where balls were seen too seldom
    after it."""
    story = solution.story
    span, lying = story.spans[come], [one for one in lying if one.ball != story.spans[come].ball]
    begins = max(story.begin(come), hit - LOOKED_BACK)
    state = kinematics(span.state[None], np.array([begins - story.begin(come)]), solution.friction)[0]
    speed = float(np.hypot(*state[2:4]))
    window = min(max(WAY * table.ball_radius / speed, LEAST_PICTURES * interval), LONGEST)
    balls = (span.ball, *(one.ball for one in lying))
    chosen, number = [], []
    for place, ball in enumerate(balls):
        begin, end = begins if place == 0 else hit, _until(solution, ball, hit, window)
        rows = np.flatnonzero((data.ball == ball) & (data.t >= begin) & (data.t < end))
        rows = rows[~_in_jaws(data.xy[rows], table)]
        chosen.append(rows)
        number.append(np.full(len(rows), place))
    rows, which = np.concatenate(chosen), np.concatenate(number)
    if np.sum(data.t[rows] > hit) < 2 * len(balls):
        return None
    sigma = np.full(7, np.inf)
    if np.sum(data.t[chosen[0]] < hit) < ENOUGH:
        sigma[:4] = [_PLACE_SIGMA, _PLACE_SIGMA, _SPEED_SIGMA * speed, _SPEED_SIGMA * speed]
    return Burst(
        balls, begins, hit, np.append(state[:6], 0.0), sigma, np.array([one.place for one in lying]),
        np.array([one.sigma for one in lying]), data.t[rows], which, data.xy[rows], data.whiten[rows], interval,
        (solution.friction.sliding, solution.friction.rolling), solution.diameter, replace(table, pockets=False),
    )  # fmt: skip


def _until(solution: Solution, ball: int, hit: float, window: float) -> float:
    """s until which a ball is watched: its first cushion after the hit ends it."""
    story = solution.story
    met = [c.t for c in story.contacts if c.kind == "cushion" and c.t > hit and ball in story.balls_at(c)]
    return min([hit + window, *met])


def _in_jaws(xy: FloatArray, table: Table) -> NDArray[np.bool_]:
    """(K,) which places (K, 2) are in or before a pocket."""
    if not table.pockets:
        return np.zeros(len(xy), np.bool_)
    apart = np.linalg.norm(xy[:, None] - table.pocket_centres, axis=2)
    return np.asarray(apart.min(axis=1) < _JAWS * table.ball_radius)
