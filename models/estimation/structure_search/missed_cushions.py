"""Cushions that a refined story does not know of yet, paths running through them or turning back for no cause; and
rebounds that it tells wrongly, since slip that is spent within a picture or two is no more found by small steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import SLOW
from models.estimation.joint_fit.fit_solution import Data, Solution, end_state
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.joint_fit.physics_priors import CUSHION_RESTITUTION
from models.estimation.segmentation.contact_classification import INWARD, NEAR_CUSHION, cushion_distances
from models.estimation.segmentation.contact_graph import Contact, Story
from models.physics.billiards.cloth.closed_form_motion import kinematics

OVERSHOOT = 0.2
"""ball radii: a path that goes so far into a cushion has met it."""

SLIPPING, STICKING = (np.array([CUSHION_RESTITUTION[0], 0.0, grip]) for grip in (0.0, 1.0))
"""Rubber, as in `Solution.rubber`, between which all noses are: a mirror's and Mathavan's."""


def with_rebounds_retold(solution: Solution, data: Data, table: Table) -> Solution:
    """The best refined solution of a story, begun from where it is and from rebounds off noses that slip or stick.

    A ball that leaves a cushion slides for a tenth of a second. Where three pictures show it, a slow ball that rolls
    at once fits them nearly as well, and no small step leads from the one to the other.
    """
    if not any(contact.kind == "cushion" for contact in solution.story.contacts):
        return solution
    starts = [_rebounding(solution, rubber) for rubber in (SLIPPING, STICKING)]
    tried = [refine(start.story, data, table, start=start) for start in starts]
    return min([solution, *tried], key=lambda one: one.chi2)


def _rebounding(solution: Solution, rubber: FloatArray) -> Solution:
    """The solution whose balls leave cushions along the normal as `rubber` (3,) has them leave, with its slip."""
    story, (restitution, slower, grip) = solution.story, rubber
    spans = list(story.spans)
    for contact in story.contacts:
        if contact.kind != "cushion" or spans[contact.after[0]].static:
            continue
        n, before = INWARD[CUSHIONS.index(contact.cushion)], end_state(solution, contact.before[0])
        coming, slip = float(n @ before[2:4]), float(n @ before[4:6])
        leaving = (restitution - slower * coming) * -coming
        slipping = slip + (leaving - coming) - grip * (slip - restitution * coming)  # as `knowledge` has spin survive
        state = spans[contact.after[0]].state.copy()
        state[2:4] += (leaving - n @ state[2:4]) * n
        state[4:6] += (slipping - n @ state[4:6]) * n
        state[6:8] = 0.0
        spans[contact.after[0]] = replace(spans[contact.after[0]], state=state)
    return replace(solution, story=Story(tuple(spans), story.contacts), nose=np.zeros(4), rubber=rubber.copy())


def renamed(solution: Solution, table: Table) -> Story:
    """Changes of velocity without a cause that turn out to lie at a cushion."""
    contacts = list(solution.story.contacts)
    changed = False
    for number, contact in enumerate(contacts):
        if contact.kind != "free":
            continue
        side = _reversed_at(solution, contact, table)
        if side is not None:
            contacts[number] = replace(contact, kind="cushion", cushion=CUSHIONS[side])
            changed = True
    return Story(solution.story.spans, tuple(contacts)) if changed else solution.story


def _reversed_at(solution: Solution, contact: Contact, table: Table, but: int = -1) -> int | None:
    """The cushion near which a ball turns back at a contact, other than `but`."""
    spans = solution.story.spans
    before, after = end_state(solution, contact.before[0]), spans[contact.after[0]].state
    distance = cushion_distances(after[:2], table) - table.ball_radius - solution.nose
    reach = 0.5 * NEAR_CUSHION * table.ball_radius
    for side in np.argsort(np.abs(distance)):
        towards, away = -INWARD[side] @ before[2:4], INWARD[side] @ after[2:4]
        if side != but and abs(distance[side]) < reach and towards > SLOW and away > 0:
            return int(side)
    return None


def doubled(solution: Solution, story: Story, table: Table) -> Story:
    """In a corner a ball meets two cushions within one picture."""
    for contact, told in zip(solution.story.contacts, story.contacts, strict=False):
        if contact.kind != "cushion" or contact != told:  # other thoughts may have changed or shortened the story
            continue
        first = CUSHIONS.index(contact.cushion)
        second = _reversed_at(solution, contact, table, but=first)
        if second is None:
            continue
        before = end_state(solution, contact.before[0])
        after = story.spans[contact.after[0]].state.copy()
        middle = after.copy()  # between the two contacts only the first component has turned
        n = INWARD[second]
        middle[2:4] += (n @ before[2:4] - n @ after[2:4]) * n
        spans = list(story.spans)
        spans[contact.after[0]] = replace(spans[contact.after[0]], state=middle)
        t = min(contact.t + 2e-3, story.finish(contact.after[0]) - 1e-3)
        if t > contact.t + 2e-4:
            extra = Contact("cushion", t, (contact.after[0],), (), CUSHIONS[second], gain=contact.gain)
            story = Story(tuple(spans), story.contacts).split(extra, (after,))
    return story


def inserted(solution: Solution, story: Story, data: Data, table: Table) -> Story:
    """Cushions that paths run through."""
    if story is not solution.story:
        return story
    last = {int(ball): float(data.t[data.ball == ball].max()) for ball in np.unique(data.ball)}
    for k, span in enumerate(solution.story.spans):
        if span.static:
            continue
        begin, end = story.begin(k), min(story.finish(k), last[span.ball])
        if end - begin < 1e-3:
            continue
        t = np.linspace(begin, end, max(int((end - begin) / 1e-3), 8))
        path = kinematics(np.repeat(span.state[None], len(t), axis=0), t - begin, solution.friction)
        depth = -(cushion_distances(path[:, :2], table) - table.ball_radius - solution.nose)  # (M, 4)
        side = int(np.argmax(depth.max(axis=0)))
        deepest = int(np.argmax(depth[:, side]))
        inwards = path[:, 2:4] @ INWARD[side]
        turns = 0 < deepest < len(t) - 1 and -inwards[:deepest].min() > SLOW and inwards[deepest:].max() > SLOW
        if turns and depth[deepest, side] > -2 * OVERSHOOT * table.ball_radius:
            depth[:, side] += max(-depth[deepest, side], 0.0) + 1e-4  # no ball turns back at a cushion by itself
        elif depth[deepest, side] < OVERSHOOT * table.ball_radius:
            continue
        if depth[0, side] > 0.5 * OVERSHOOT * table.ball_radius:
            continue
        if _in_pocket_mouth(path[int(np.argmax(depth[:, side])), :2], table):
            continue
        crossing = int(np.argmax(depth[:, side] > 0))
        if crossing in (0, len(t) - 1) or -INWARD[side] @ path[crossing, 2:4] < 0:
            continue
        before = path[crossing]
        after = np.concatenate([before, np.zeros(2)])
        push = -1.75 * (INWARD[side] @ before[2:4]) * INWARD[side]
        after[2:4] += push
        after[4:6] += push
        contact = Contact("cushion", float(t[crossing]), (k,), (), CUSHIONS[side])
        story = story.split(contact, (after,))
    return story


def _in_pocket_mouth(x: FloatArray, table: Table) -> bool:
    """Where there is no cushion to meet: within three radii of a pocket."""
    return bool(
        len(table.pocket_centres) and np.linalg.norm(table.pocket_centres - x, axis=1).min() < 3 * table.ball_radius
    )
