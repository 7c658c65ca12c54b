"""Refit of strikes: a ball that slid before its first frame was struck later, and harder, than one that rolled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph
from models.core.joint_solution import JointSolution, Observations
from models.core.scene import Table
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_SPEED
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.physics.billiards.cloth.closed_form_motion import GRAVITY

MAX_ROLLING_SLIP = 0.5
"""Slip over speed below which a struck ball resembles a rolling one more than one hit in its middle."""
MIN_REMAINING_SHARE = 0.1
"""Least share of the time from a strike to the next sample that remains after the strike moves."""


def refit_strikes(solution: JointSolution, observations: Observations, table: Table) -> JointSolution:
    """Refit a graph also from central hits, and select the best solution.

    How far a slide throws a ball back grows with the square of its slip: where no frame shows the slide, no small step
    leads from a ball that rolls at once to one that slides first.

    Args:
        solution: A refined solution.
        observations: K observations.
        table: The table.

    Returns:
        The solution of least chi2.
    """
    rolling = [number for number, contact in enumerate(solution.graph.contacts) if _starts_rolling(solution, contact)]
    if not rolling:
        return solution
    start = _set_central_hits(solution, observations, rolling)
    return min([solution, refine_graph(start.graph, observations, table, initial=start)], key=lambda one: one.chi2)


def _starts_rolling(solution: JointSolution, contact: Contact) -> bool:
    """Return whether a struck ball starts almost rolling."""
    segments = solution.graph.segments
    if contact.kind != "strike" or contact.pushed or not segments[contact.before[0]].static:
        return False
    v, slip = np.split(segments[contact.after[0]].state[2:6], 2)
    speed = float(np.hypot(*v))
    return speed > MIN_CONTACT_SPEED and float(slip @ v) < MAX_ROLLING_SLIP * speed**2


def _set_central_hits(solution: JointSolution, observations: Observations, strikes: list[int]) -> JointSolution:
    """Let struck balls slip with all their velocity, and roll on later as they do now."""
    graph = solution.graph
    segments, contacts = list(graph.segments), list(graph.contacts)
    for number in strikes:
        contact, segment = contacts[number], contacts[number].after[0]
        state = segments[segment].state.copy()
        rolling_velocity = state[2:4] - 2 / 7 * state[4:6]
        speed = max(float(np.hypot(*rolling_velocity)), MIN_CONTACT_SPEED)
        v = 7 / 5 * rolling_velocity
        ahead = _slide_displacement(v, solution.friction.sliding) - _slide_displacement(
            state[4:6], solution.friction.sliding
        )
        later_times = observations.t[(observations.ball == segments[segment].ball) & (observations.t > contact.t)]
        until = min(float(later_times[0]) if len(later_times) else np.inf, graph.end_time(segment))
        t = contact.t + min(float(ahead @ rolling_velocity) / speed**2, (1 - MIN_REMAINING_SHARE) * (until - contact.t))
        state[2:4], state[4:6] = v, v
        segments[segment] = replace(segments[segment], t0=t, state=state)
        contacts[number] = replace(contact, t=t)
    return replace(solution, graph=ContactGraph(tuple(segments), tuple(contacts)))


def _slide_displacement(slip: np.ndarray, friction: float) -> np.ndarray:
    """Return the distance (2,) m by which a sliding ball, once it rolls, is ahead of one that rolled at once."""
    return np.asarray(2 / 49 * slip * np.hypot(*slip) / (friction * GRAVITY))
