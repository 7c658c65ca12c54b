"""Strikes told anew: a ball that slid before its first picture was struck later, and harder, than one that rolled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.scene import Table
from models.estimation.joint_fit.contact_cascades import SLOW
from models.estimation.joint_fit.fit_solution import Data, Solution
from models.estimation.joint_fit.joint_refinement import refine
from models.estimation.segmentation.contact_graph import Contact, Story
from models.physics.billiards.cloth.closed_form_motion import GRAVITY

ROLLS = 0.5
"""Slip over speed below which a struck ball sets off more like one that rolls than like one hit in its middle."""
LEAST_LEFT = 0.1
"""Share of the time from a strike to the next picture of the ball that is left when the strike is told later."""


def with_strikes_retold(solution: Solution, data: Data, table: Table) -> Solution:
    """The best refined solution of a story, begun from where it is and from balls that are hit in their middles.

    How far a slide throws a ball back goes with the square of its slip: where no picture shows the slide, no small
    step leads from a ball that rolls at once to one that slides first.
    """
    rolling = [number for number, contact in enumerate(solution.story.contacts) if _rolls(solution, contact)]
    if not rolling:
        return solution
    start = _hit_in_the_middle(solution, data, rolling)
    return min([solution, refine(start.story, data, table, start=start)], key=lambda one: one.chi2)


def _rolls(solution: Solution, contact: Contact) -> bool:
    """Whether a ball that a cue struck begins nearly as one that rolls."""
    spans = solution.story.spans
    if contact.kind != "strike" or contact.pushed or not spans[contact.before[0]].static:
        return False
    v, slip = np.split(spans[contact.after[0]].state[2:6], 2)
    speed = float(np.hypot(*v))
    return speed > SLOW and float(slip @ v) < ROLLS * speed**2


def _hit_in_the_middle(solution: Solution, data: Data, strikes: list[int]) -> Solution:
    """The solution whose struck balls slip with all their velocity, and roll on later as they do now."""
    story = solution.story
    spans, contacts = list(story.spans), list(story.contacts)
    for number in strikes:
        contact, span = contacts[number], contacts[number].after[0]
        state = spans[span].state.copy()
        rolls = state[2:4] - 2 / 7 * state[4:6]
        pace = max(float(np.hypot(*rolls)), SLOW)
        v = 7 / 5 * rolls
        ahead = _thrown(v, solution.friction.sliding) - _thrown(state[4:6], solution.friction.sliding)
        seen = data.t[(data.ball == spans[span].ball) & (data.t > contact.t)]
        until = min(float(seen[0]) if len(seen) else np.inf, story.finish(span))
        t = contact.t + min(float(ahead @ rolls) / pace**2, (1 - LEAST_LEFT) * (until - contact.t))
        state[2:4], state[4:6] = v, v
        spans[span] = replace(spans[span], t0=t, state=state)
        contacts[number] = replace(contact, t=t)
    return replace(solution, story=Story(tuple(spans), tuple(contacts)))


def _thrown(slip: np.ndarray, friction: float) -> np.ndarray:
    """By how far (2,) m a ball is ahead, once it rolls, of one that rolled from the beginning."""
    return np.asarray(2 / 49 * slip * np.hypot(*slip) / (friction * GRAVITY))
