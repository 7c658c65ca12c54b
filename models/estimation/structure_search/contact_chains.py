"""Contacts that sent off more than they were told to: what follows from one within a picture or three, told together.

A ball that runs into another one which lies against a third is seen to stop, and the third to start; the one between
hardly moves. Once the first contact is told alone, what it sets going has no cause, or bends the paths.
"""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.estimation.joint_fit.contact_cascades import Hit, cascade, with_hits
from models.estimation.joint_fit.fit_solution import Data, Solution, owners
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.joint_fit.trust_level import span_chi2
from models.estimation.segmentation.contact_graph import Contact, Story
from models.estimation.structure_search.ball_encounters import NEAR_IN_TIME, Answers, interval_of, total_cost

HORIZONS = (1.0, 2.5)
"""picture intervals after a contact in which it may send balls off."""
BENT = 1.5
"""chi2 per degree of freedom of a path that a contact more may mend."""
MOST_TRIED = 6
"""in one round."""
TRIAL = 10
"""iterations that show whether a story is worth more of them."""


def with_rows(
    solution: Solution, data: Data, table: Table, tolls: tuple[float, float], asked: Answers
) -> Solution:  # fmt: skip
    """The solution whose contacts of balls are told with what follows from them, where the whole clip pays for that.

    `tolls` are the prices of contacts with a cause and without; `asked` keeps what was refused.
    """
    tries = 0
    for contact in _odd(solution, data):
        for horizon in HORIZONS:
            number = next((k for k, one in enumerate(solution.story.contacts) if one == contact), None)
            if number is None or tries >= MOST_TRIED:
                break
            question = (horizon, *sorted(solution.story.balls_at(contact)), round(contact.t, 2))
            story = None if question in asked.needed else _retold(solution, data, table, number, horizon)
            if story is None:
                continue
            tries += 1
            tried = refine(story, data, table, TRIAL, solution)
            if total_cost(tried, tolls) < total_cost(solution, tolls):
                solution = refine(tried.story, data, table, start=tried)
            else:
                asked.needed.add(question)
    return solution


def _odd(solution: Solution, data: Data) -> list[Contact]:
    """Contacts of balls beside which a ball sets off for no cause, or whose paths are bent, the worst first."""
    story, reach = solution.story, NEAR_IN_TIME * interval_of(data)
    chi2 = np.nan_to_num(span_chi2(solution, data)[0], nan=0.0)
    loose = np.array([c.t for c in story.contacts if c.kind == "free" or c.pushed])
    found = []
    for contact in story.contacts:
        if contact.kind == "ball":
            bent = float(chi2[[*contact.before, *contact.after]].max())
            beside = bool(len(loose) and np.abs(loose - contact.t).min() < reach)
            if beside or bent > BENT:
                found.append((-bent - 10.0 * beside, contact.t, contact))
    return [contact for _, _, contact in sorted(found, key=lambda one: one[:2])]


def _retold(solution: Solution, data: Data, table: Table, number: int, horizon: float) -> Story | None:
    """The story with what follows from a contact; None where nothing does that is not told."""
    story, interval = solution.story, interval_of(data)
    contact = story.contacts[number]
    a, b = (story.spans[k].ball for k in contact.before)
    alone = story.without(number)
    radius = table.ball_radius * solution.diameter
    hits = cascade(alone, solution.friction, a, b, contact.t, horizon * interval, radius)
    told = [(c.t, story.balls_at(c)) for c in story.contacts if c.kind == "ball"]
    if all(_known(hit, told, 2 * horizon * interval) for hit in hits[1:]):
        return None
    met = with_hits(alone, solution.friction, data, owners(alone, data), hits, NEAR_IN_TIME * interval)
    return None if met is None else met.with_pushes()


def _known(hit: Hit, told: list[tuple[float, set[int]]], near: float) -> bool:
    return any(balls == {hit.a, hit.b} and abs(t - hit.t) < near for t, balls in told)
