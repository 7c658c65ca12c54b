"""Two balls that set out from rest within one picture: no cue strikes twice so soon, so the one has sent off the other.

Between the two pictures neither is seen in motion, and the path that is fitted to the struck ball without the contact
goes past the other. What is seen of the other tells both where they met and when.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np

from models.core.scene import Table
from models.estimation.joint_fit.contact_cascades import SHORTEST, SLOW
from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.segmentation.contact_graph import Contact, Story
from models.estimation.structure_search.ball_encounters import interval_of, total_cost


def opened(solution: Solution, data: Data, table: Table, tolls: tuple[float, float]) -> Solution:
    """The solution in which, of two balls that set out within one picture, one is struck and meets the other.

    Either may be the struck one; it is told so where the samples pay for it. `tolls` are the prices of contacts with a
    cause and without.
    """
    cost = total_cost(solution, tolls)
    for struck, hit in _set_out_together(solution.story, interval_of(data)):
        story = _sent_off(solution, data, struck, hit, table)
        if story is None:
            continue
        tried = refine(story, data, table, start=solution)
        if total_cost(tried, tolls) < cost:
            return opened(tried, data, table, tolls)
    return solution


def _set_out_together(story: Story, interval: float) -> list[tuple[int, int]]:
    """Pairs of contacts, both orders, at which balls leave their rest within one picture without a ball that hits
    them."""
    starts = [
        number
        for number, contact in enumerate(story.contacts)
        if contact.kind == "strike" and story.spans[contact.before[0]].static
    ]
    return [
        (one, other)
        for one, other in permutations(starts, 2)
        if abs(story.contacts[one].t - story.contacts[other].t) < interval
    ]


def _sent_off(solution: Solution, data: Data, struck: int, hit: int, table: Table) -> Story | None:
    """The story in which the ball of the strike `struck` runs into that of `hit`; None where it cannot have done so.

    The hit ball leaves along the line of centres, which says where the other one was; both together have the momentum
    that the struck one brought, which says when it set out.
    """
    story, struck, hit = _without_turn(solution.story, struck, hit, interval_of(data))
    first, second = story.contacts[struck], story.contacts[hit]
    leaves = story.spans[second.after[0]].state
    speed = float(np.hypot(*leaves[2:4]))
    onward = first.after[0]
    later = np.flatnonzero((data.ball == story.spans[onward].ball) & (data.t > second.t + SHORTEST))
    if speed < SLOW or not len(later) or story.finish(onward) < data.t[later[0]]:
        return None
    rest = story.spans[first.before[0]].state[:2]
    meeting = leaves[:2] - 2 * table.ball_radius * solution.diameter * leaves[2:4] / speed
    went = (data.xy[later[0]] - meeting) / (data.t[later[0]] - second.t)
    after = np.concatenate([meeting, went, story.spans[onward].state[4:]])
    way = meeting - rest
    length = float(np.hypot(*way))
    brought = float((after[2:4] + leaves[2:4]) @ way) / max(length, 1e-9)
    known = data.t[(data.ball == story.spans[onward].ball) & (data.t < second.t)]
    if brought < SLOW or length < SHORTEST * brought or not len(known):
        return None
    t = max(second.t - length / brought, float(known[-1]))
    if second.t - t < SHORTEST:
        return None
    spans, contacts, v = list(story.spans), list(story.contacts), brought * way / length
    fresh = len(spans)
    spans.append(  # hit in its middle, as `span_priors` has it
        replace(spans[onward], end=hit, t0=t, state=np.concatenate([rest, v, v, np.zeros(2)]))
    )
    spans[onward] = replace(spans[onward], start=hit, t0=second.t, state=after)
    contacts[struck] = replace(first, t=t, after=(fresh,))
    contacts[hit] = Contact(
        "ball", second.t, (fresh, *second.before), (onward, *second.after), gain=first.gain + second.gain
    )
    return Story(tuple(spans), tuple(contacts)).with_pushes()


def _without_turn(story: Story, struck: int, hit: int, interval: float) -> tuple[Story, int, int]:
    """The story, and the numbers of two contacts in it, without what turns the struck ball for no cause within one
    picture of the other's leaving: that is their meeting."""
    turn = story.spans[story.contacts[struck].after[0]].end
    if turn is None or story.contacts[turn].kind != "free":
        return story, struck, hit
    if not 0 <= story.contacts[turn].t - story.contacts[hit].t < interval:
        return story, struck, hit
    return story.without(turn), struck - (struck > turn), hit - (hit > turn)
