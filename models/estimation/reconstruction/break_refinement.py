"""A story whose bursts are played: each ball of a burst is left alone until its last contact there, and goes on from
where the play has it."""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.core.trajectory import Trajectory
from models.estimation.break_shot.break_data import Burst
from models.estimation.break_shot.break_posterior import Leaving, ToldBurst, told
from models.estimation.break_shot.break_search import search
from models.estimation.joint_fit.contact_cascades import span_before
from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.reconstruction.event_list import Happening
from models.estimation.reconstruction.trajectory_assembly import Piece, shifted
from models.estimation.segmentation.contact_graph import Contact, Story
from models.estimation.structure_search.rack_detection import racks, rests_from

WORST_CHI2 = 20.0
"""per degree of freedom, robust: a play that misses more explains nothing."""
CERTAIN = 1e6
"""chi2: what a play tells is not doubted by the story around it."""
NEXT = 1e-9
"""s: a moment later."""
TWICE = 2.0
"""Variance of what a play says, over its own: the samples after a burst have told it already."""
_SEED = 1987
"""of the racks that are tried: the same clip gives the same play."""


def with_bursts(
    solution: Solution, data: Data, table: Table, rng: np.random.Generator | None = None
) -> tuple[Solution, Data, tuple[ToldBurst, ...]]:
    """The solution with its bursts played where a play explains them, the samples that the rest of it answers for, and
    the bursts."""
    chance = np.random.default_rng(_SEED) if rng is None else rng
    bursts = []
    for burst in racks(solution, data, table):
        plays = search(burst, chance)
        if plays is None or plays.chi2_per_dof > WORST_CHI2:
            continue
        found = told(plays)
        if found.touches:
            bursts.append(found)
    if not bursts:
        return solution, data, ()
    story = solution.story
    for one in bursts:
        story = _retold(story, one)
    rest = _joined(seen_outside(data, tuple(bursts)), tuple(bursts))
    return refine(story, rest, table, start=solution), rest, tuple(bursts)


def seen_outside(data: Data, bursts: tuple[ToldBurst, ...]) -> Data:
    """The samples but those between the first contact of a ball in a burst and its last one."""
    keep = np.ones(len(data.t), np.bool_)
    for one in (leaving for burst in bursts for leaving in burst.leaving):
        keep &= ~((data.ball == one.ball) & (data.t > one.since) & (data.t <= one.until))
    return Data(data.ball[keep], data.t[keep], data.xy[keep], data.whiten[keep])


def touches_of(bursts: tuple[ToldBurst, ...], ids: tuple[str, ...]) -> list[Happening]:
    """Contacts in bursts as events."""
    return [
        Happening("ball", one.t, one.t_sigma, ids[one.a], ids[one.b], one.xy, one.probability, speed=one.speed)
        for burst in bursts for one in burst.touches
    ]  # fmt: skip


def pieces_in(bursts: tuple[ToldBurst, ...]) -> list[Piece]:
    """The motion of balls in bursts, as the best plays have it."""
    found = []
    for burst in bursts:
        motion, seen = burst.plays.played[0].run.trajectory(), burst.plays.burst
        for one in burst.leaving:
            found += _played(motion, seen.balls.index(one.ball), one, seen.begins)
    return found


def _played(motion: Trajectory, number: int, one: Leaving, begins: float) -> list[Piece]:
    """Pieces of one ball of a play that begins at `begins`, s, from its first contact to its last."""
    found = []
    loose = one.covariance[:4, :4]
    for k in np.flatnonzero(motion.ball == number):
        start, end = max(float(motion.start[k]) + begins, one.since), min(float(motion.end[k]) + begins, one.until)
        if end - start < 1e-9:
            continue
        later = start - begins - float(motion.start[k])
        position = shifted(motion.position[k], later)
        spin = np.array([motion.spin[k, 0] + later * motion.spin[k, 1], motion.spin[k, 1]])
        found.append(Piece(one.ball, start, end, position, spin, motion.phase[k], loose))
    return found


def _retold(story: Story, burst: ToldBurst) -> Story:
    """The story in which balls leave a burst as it was played."""
    plays = burst.plays.burst
    ends = max(one.until for one in burst.leaving) + plays.interval
    begins = {one.ball: _known_until(story, plays, one.ball) for one in burst.leaving}
    while gone := [
        k for k, c in enumerate(story.contacts)
        if c.kind != "burst" and (c.t <= plays.hit or c.kind != "cushion")
        and any(begins[ball] < c.t <= ends for ball in begins.keys() & story.balls_at(c))
    ]:  # fmt: skip
        story = story.without(gone[-1])
    for one in burst.leaving:
        k = span_before(story, one.ball, one.until)
        whiten = np.linalg.inv(np.linalg.cholesky(TWICE * one.covariance))
        contact = Contact(
            "burst", one.until, (k,), (), gain=CERTAIN, since=one.since, leaves=one.state, whiten=whiten
        )  # fmt: skip
        story = story.split(contact, (np.concatenate([one.state, np.zeros(2)]),))
    return story.with_pushes()


def _joined(data: Data, bursts: tuple[ToldBurst, ...]) -> Data:
    """The samples, and as one more of each ball of a burst where it is at its first contact there."""
    came = [one for burst in bursts for one in burst.leaving]
    ball = np.concatenate([data.ball, np.array([one.ball for one in came], dtype=np.int64)])
    t = np.concatenate([data.t, [one.since - NEXT for one in came]])
    xy = np.concatenate([data.xy, [one.came for one in came]])
    known = [np.linalg.inv(np.linalg.cholesky(TWICE * one.came_covariance)) for one in came]
    order = np.lexsort((t, ball))
    return Data(ball[order], t[order], xy[order], np.concatenate([data.whiten, known])[order])


def _known_until(story: Story, burst: Burst, ball: int) -> float:
    """s until which the story of a ball stands: until the coming one is on its way, and the others begin to rest."""
    if ball == burst.balls[0]:
        return story.begin(span_before(story, ball, burst.begins + NEXT))
    return rests_from(story, ball, burst.hit)
