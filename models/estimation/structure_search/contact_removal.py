"""Contacts of two balls that never were: what breaks their paths is unknown again, until a better cause is found.

In a break one ball seems to meet another where several met within a picture. What laws then make of it bends both paths
for as long as they last.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.scene import Table
from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.joint_fit.trust_level import span_chi2
from models.estimation.segmentation.contact_graph import Contact, ContactKind, Story
from models.estimation.structure_search.ball_encounters import Answers, total_cost

BENT = 3.0
"""chi2 per degree of freedom of a path that its contacts bend."""
MOST_RELEASED = 3
"""in one round, the most bent first."""
TRIAL = 10
"""iterations that show whether a story is worth more of them."""


def released(solution: Solution, data: Data, table: Table, tolls: tuple[float, float], asked: Answers) -> Solution:
    """The solution without contacts of balls whose paths are bent, where two unknown causes cost less.

    `tolls` are the prices of contacts with a cause and without; `asked` keeps which are not to be asked for again.
    """
    chi2, _, _ = span_chi2(solution, data)
    bent = np.nan_to_num(chi2, nan=0.0)
    worst = {
        number: float(bent[[*contact.before, *contact.after]].max())
        for number, contact in enumerate(solution.story.contacts)
        if contact.kind == "ball"
    }
    for number in sorted(worst, key=lambda number: -worst[number])[:MOST_RELEASED]:
        contact = solution.story.contacts[number]
        question = (*sorted(solution.story.balls_at(contact)), round(contact.t, 2))
        if worst[number] < BENT or question in asked.needed:
            continue
        tried = refine(_apart(solution.story, number), data, table, TRIAL, solution)
        if total_cost(tried, tolls) < total_cost(solution, tolls):
            solution = refine(tried.story, data, table, start=tried)
        else:
            asked.needed.add(question)
    return solution


def _apart(story: Story, number: int) -> Story:
    """The story in which each ball of a contact changes its velocity by itself; the first one keeps the number."""
    contact, spans, contacts = story.contacts[number], list(story.spans), list(story.contacts)
    for slot, place in ((0, number), (1, len(contacts))):
        before, after = contact.before[slot], contact.after[slot]
        kind: ContactKind = "strike" if spans[before].static else "free"
        alone = Contact(kind, contact.t, (before,), (after,), gain=contact.gain)
        spans[before], spans[after] = replace(spans[before], end=place), replace(spans[after], start=place)
        contacts[place : place + 1] = [alone]
    return Story(tuple(spans), tuple(contacts)).with_pushes()
