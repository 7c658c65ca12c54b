"""Cushions met so shortly before or after another contact that the samples between are too few for a break of the path.

A ball that runs into a corner meets two cushions within a picture or two, one that is hit beside a rail comes back from
it at once. Such a pair is told as one contact, which no law explains: a cushion is tried on either side of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import SHORTEST, SLOW
from models.estimation.joint_fit.fit_solution import Data, Solution, end_state, owners
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.joint_fit.physics_priors import CUSHION_RESTITUTION
from models.estimation.segmentation.contact_classification import INWARD, NEAR_CUSHION, cushion_distances
from models.estimation.segmentation.contact_graph import Contact, Story
from models.estimation.structure_search.ball_encounters import as_refined, interval_of, refined_part, total_cost
from models.physics.billiards.cloth.closed_form_motion import kinematics

SOON = 2.5
"""picture intervals: farther from another contact, a cushion breaks the path by itself."""
SLIDE = 0.2
"""s: how long spin may take to do what a cushion did."""
MOST_TRIED = 4
"""of these cushions that the whole clip is asked for in one round."""


@dataclass(frozen=True, slots=True)
class _Corner:
    """A story with one cushion more, which cuts one of the spans of a contact."""

    contact: Contact
    states: tuple[FloatArray, FloatArray]
    """(8,) of the span that is cut, at its beginning, and of the new one."""
    around: int
    """The contact beside it."""


def with_corners(solution: Solution, data: Data, table: Table, tolls: tuple[float, float]) -> Solution:
    """The solution with the cushions beside other contacts that pay for themselves, each asked of the whole clip.

    `tolls` are the prices of contacts with a cause and without.
    """
    trials = _worth_it(solution, data, table, tolls)
    touched: set[int] = set()
    for gain, corner, part in sorted(trials, key=lambda trial: -trial[0])[:MOST_TRIED]:
        region = _region(solution.story, corner.around)
        if gain <= 0 or touched & set(region):
            continue
        grown = _grown(solution.story, corner)
        story = as_refined(grown, part, [*region, len(solution.story.spans)]).with_pushes()
        tried = refine(story, data, table, start=solution)
        if total_cost(tried, tolls) < total_cost(solution, tolls):
            solution = tried
            touched |= {*region, len(story.spans) - 1}
    return solution


def _worth_it(
    solution: Solution, data: Data, table: Table, tolls: tuple[float, float]
) -> list[tuple[float, _Corner, Story]]:
    """What every corner gains in chi2 where it lies, all prices paid, and the spans there, refined by themselves."""
    owner, found = owners(solution.story, data), []
    alone: dict[int, float] = {}
    for corner in _corners(solution, table, SOON * interval_of(data)):
        region = _region(solution.story, corner.around)
        rows = np.isin(owner, region)
        if not rows.any():
            continue
        local = Data(data.ball[rows], data.t[rows], data.xy[rows], data.whiten[rows])
        if corner.around not in alone:
            alone[corner.around] = total_cost(refined_part(solution, solution.story, region, local, table), tolls)
        spans = [*region, len(solution.story.spans)]
        part = refined_part(solution, _grown(solution.story, corner), spans, local, table)
        found.append((alone[corner.around] - total_cost(part, tolls), corner, part.story))
    return found


def _region(story: Story, contact: int) -> list[int]:
    one = story.contacts[contact]
    return sorted({*one.before, *one.after})


def _grown(story: Story, corner: _Corner) -> Story:
    k = corner.contact.before[0]
    spans = list(story.spans)
    spans[k] = replace(spans[k], state=corner.states[0])
    return Story(tuple(spans), story.contacts).split(corner.contact, (corner.states[1],))


def _corners(solution: Solution, table: Table, soon: float) -> list[_Corner]:
    """Cushions that balls may have met less than `soon` s before or after what else they met."""
    found = []
    for number, contact in enumerate(solution.story.contacts):
        if contact.kind in ("jump", "burst"):
            continue
        for before, after in zip(contact.before, contact.after, strict=True):
            place = solution.story.spans[after].state[:2]
            beyond = cushion_distances(place, table) - table.ball_radius - solution.nose
            for side in np.flatnonzero(beyond > -0.5 * NEAR_CUSHION * table.ball_radius):
                way, cushion = max(float(beyond[side]), 0.0), CUSHIONS[side]
                if contact.kind != "cushion" or contact.cushion != cushion:
                    then = _then(solution, after, INWARD[side], way, cushion, soon)
                    first = _first(solution, before, INWARD[side], way, cushion, soon)
                    found += [_Corner(*one, number) for one in (then, first) if one is not None]
    return found


def _then(
    solution: Solution, k: int, n: FloatArray, way: float, cushion: str, soon: float
) -> tuple[Contact, tuple[FloatArray, FloatArray]] | None:
    """Span k meets a cushion `way` m off after it begins: as it is told it goes away from there, or spin turns it."""
    span, story = solution.story.spans[k], solution.story
    begin = story.begin(k)
    later = min(SLIDE, story.finish(k) - begin)
    gone = kinematics(span.state[None], np.array([later]), solution.friction)[0]
    leaving = float(n @ gone[2:4])
    if span.static or leaving < SLOW:
        return None
    coming = -leaving / CUSHION_RESTITUTION[0]
    wait = max(way / -coming, 2 * SHORTEST)
    if wait > min(2 * soon, later - 2 * SHORTEST):
        return None
    if wait > soon:  # where spin turned it, it was slower than it comes out
        wait, coming = soon, -way / soon
    middle, after = span.state.copy(), np.concatenate([gone, np.zeros(2)])
    middle[2:4] += (coming - n @ middle[2:4]) * n
    middle[4:6] += (coming - n @ middle[4:6]) * n  # without spin: its slip is its velocity
    after[:2] -= (later - wait) * gone[2:4]
    after[:2] += (n @ (span.state[:2] - after[:2]) - way) * n
    after[4:6] += (_slipping(coming, leaving) - n @ after[4:6]) * n
    return Contact("cushion", begin + wait, (k,), (), cushion), (middle, after)


def _first(
    solution: Solution, k: int, n: FloatArray, way: float, cushion: str, soon: float
) -> tuple[Contact, tuple[FloatArray, FloatArray]] | None:
    """Span k meets a cushion before it ends `way` m off: as it is told it still runs towards it there."""
    span, story = solution.story.spans[k], solution.story
    coming = float(n @ end_state(solution, k)[2:4])
    if span.static or coming > -SLOW:
        return None
    leaving = -CUSHION_RESTITUTION[0] * coming
    ago = max(way / leaving, 2 * SHORTEST)
    t = story.finish(k) - ago
    if ago > soon or t < story.begin(k) + 2 * SHORTEST:
        return None
    after = np.zeros(8)
    after[:6] = kinematics(span.state[None], np.array([t - story.begin(k)]), solution.friction)[0]
    after[2:4] += (leaving - n @ after[2:4]) * n
    after[4:6] += (_slipping(coming, leaving) - n @ after[4:6]) * n
    return Contact("cushion", t, (k,), (), cushion), (span.state, after)


def _slipping(coming: float, leaving: float) -> float:
    """Slip along the normal, m/s, of a ball that leaves a nose which sticks, as `models.estimation.joint_fit.physics_priors` has it."""
    return leaving - (1 - CUSHION_RESTITUTION[0]) * coming
