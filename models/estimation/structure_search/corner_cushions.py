"""Cushion contacts so close to another contact that too few samples lie between to show a velocity change.

A ball that runs into a corner meets two cushions within a frame or two, one that is hit beside a rail comes back from
it at once. Such a pair looks like one contact, which no law explains: a cushion contact is tried on either side of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import assign_observations, end_state
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.joint_fit.prior_residuals import CUSHION_RESTITUTION
from models.estimation.segmentation.contact_classification import CUSHION_TOLERANCE, INWARD_NORMALS, cushion_distances
from models.estimation.structure_search.ball_encounters import copy_refined_states, refine_subgraph, total_cost
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# Frame intervals: farther from another contact, a cushion contact shows by itself.
MAX_CORNER_INTERVALS = 2.5
# s: how long spin may take to do what a cushion did.
SLIDE_TIME = 0.2
# Candidates that are tried on the whole clip in one round.
MAX_TRIALS = 4


@dataclass(frozen=True, slots=True)
class _CornerCandidate:
    """One more cushion contact, which cuts one of the segments of a contact."""

    contact: Contact
    states: tuple[FloatArray, FloatArray]
    """(8,) of the segment that is cut, at its start, and of the new one."""
    around: int
    """The contact beside it."""


def insert_corner_cushions(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float]
) -> JointSolution:
    """Insert the cushion contacts beside other contacts that lower the total cost of the clip.

    `prices` are those of contacts with a cause and without.
    """
    trials = _evaluate_corners(solution, observations, table, prices)
    changed: set[int] = set()
    for gain, corner, subgraph in sorted(trials, key=lambda trial: -trial[0])[:MAX_TRIALS]:
        region = _segments_around(solution.graph, corner.around)
        if gain <= 0 or changed & set(region):
            continue
        extended = _insert_corner(solution.graph, corner)
        extended_graph = copy_refined_states(
            extended, subgraph, [*region, len(solution.graph.segments)]
        ).mark_pushed_strikes()
        candidate = refine_graph(extended_graph, observations, table, initial=solution)
        if total_cost(candidate, prices) < total_cost(solution, prices):
            solution = candidate
            changed |= {*region, len(extended_graph.segments) - 1}
    return solution


def _evaluate_corners(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float]
) -> list[tuple[float, _CornerCandidate, ContactGraph]]:
    """Evaluate the local gain in chi2 of every candidate, minus prices, and refine the segments there."""
    owner, evaluated = assign_observations(solution.graph, observations), []
    base_costs: dict[int, float] = {}
    for corner in _propose_corners(solution, table, MAX_CORNER_INTERVALS * observations.frame_interval):
        region = _segments_around(solution.graph, corner.around)
        rows = np.isin(owner, region)
        if not rows.any():
            continue
        local = observations.select_rows(rows)
        if corner.around not in base_costs:
            base_costs[corner.around] = total_cost(
                refine_subgraph(solution, solution.graph, region, local, table), prices
            )
        selection = [*region, len(solution.graph.segments)]
        refined = refine_subgraph(solution, _insert_corner(solution.graph, corner), selection, local, table)
        evaluated.append((base_costs[corner.around] - total_cost(refined, prices), corner, refined.graph))
    return evaluated


def _segments_around(graph: ContactGraph, contact: int) -> list[int]:
    """Return the segments that meet at a contact."""
    one = graph.contacts[contact]
    return sorted({*one.before, *one.after})


def _insert_corner(graph: ContactGraph, corner: _CornerCandidate) -> ContactGraph:
    """Insert a candidate into the graph."""
    k = corner.contact.before[0]
    segments = list(graph.segments)
    segments[k] = replace(segments[k], state=corner.states[0])
    return ContactGraph(tuple(segments), graph.contacts).insert_contact(corner.contact, (corner.states[1],))


def _propose_corners(solution: JointSolution, table: Table, max_time: float) -> list[_CornerCandidate]:
    """Propose cushion contacts less than `max_time` s before or after other contacts."""
    candidates = []
    for number, contact in enumerate(solution.graph.contacts):
        if contact.kind in ("jump", "break"):
            continue
        for before, after in zip(contact.before, contact.after, strict=True):
            position = solution.graph.segments[after].state[:2]
            beyond = cushion_distances(position, table) - table.ball_radius - solution.nose_offsets
            for side in np.flatnonzero(beyond > -0.5 * CUSHION_TOLERANCE * table.ball_radius):
                distance, cushion = max(float(beyond[side]), 0.0), CUSHIONS[side]
                if contact.kind != "cushion" or contact.cushion != cushion:
                    later = _propose_cushion_after(solution, after, INWARD_NORMALS[side], distance, cushion, max_time)
                    earlier = _propose_cushion_before(
                        solution, before, INWARD_NORMALS[side], distance, cushion, max_time
                    )
                    candidates += [_CornerCandidate(*one, number) for one in (later, earlier) if one is not None]
    return candidates


def _propose_cushion_after(
    solution: JointSolution, k: int, n: FloatArray, distance: float, cushion: str, max_time: float
) -> tuple[Contact, tuple[FloatArray, FloatArray]] | None:
    """Propose that segment k meets a cushion `distance` m away after its start.

    Without it the segment moves away from the cushion, or spin turns it.
    """
    segment, graph = solution.graph.segments[k], solution.graph
    begin = graph.start_time(k)
    later = min(SLIDE_TIME, graph.end_time(k) - begin)
    later_state = evaluate_kinematics(segment.state[None], np.array([later]), solution.friction)[0]
    exit_speed = float(n @ later_state[2:4])
    if segment.static or exit_speed < MIN_CONTACT_SPEED:
        return None
    approach_speed = -exit_speed / CUSHION_RESTITUTION[0]
    wait = max(distance / -approach_speed, 2 * MIN_CONTACT_INTERVAL)
    if wait > min(2 * max_time, later - 2 * MIN_CONTACT_INTERVAL):
        return None
    if wait > max_time:  # if spin turned it, it was slower before than after
        wait, approach_speed = max_time, -distance / max_time
    middle, after = segment.state.copy(), np.concatenate([later_state, np.zeros(2)])
    middle[2:4] += (approach_speed - n @ middle[2:4]) * n
    middle[4:6] += (approach_speed - n @ middle[4:6]) * n  # without spin: its slip is its velocity
    after[:2] -= (later - wait) * later_state[2:4]
    after[:2] += (n @ (segment.state[:2] - after[:2]) - distance) * n
    after[4:6] += (_slip_after_sticking(approach_speed, exit_speed) - n @ after[4:6]) * n
    return Contact("cushion", begin + wait, (k,), (), cushion), (middle, after)


def _propose_cushion_before(
    solution: JointSolution, k: int, n: FloatArray, distance: float, cushion: str, max_time: float
) -> tuple[Contact, tuple[FloatArray, FloatArray]] | None:
    """Propose that segment k meets a cushion `distance` m away before its end, where it still runs towards it."""
    segment, graph = solution.graph.segments[k], solution.graph
    approach_speed = float(n @ end_state(solution, k)[2:4])
    if segment.static or approach_speed > -MIN_CONTACT_SPEED:
        return None
    exit_speed = -CUSHION_RESTITUTION[0] * approach_speed
    time_before_end = max(distance / exit_speed, 2 * MIN_CONTACT_INTERVAL)
    t = graph.end_time(k) - time_before_end
    if time_before_end > max_time or t < graph.start_time(k) + 2 * MIN_CONTACT_INTERVAL:
        return None
    after = np.zeros(8)
    after[:6] = evaluate_kinematics(segment.state[None], np.array([t - graph.start_time(k)]), solution.friction)[0]
    after[2:4] += (exit_speed - n @ after[2:4]) * n
    after[4:6] += (_slip_after_sticking(approach_speed, exit_speed) - n @ after[4:6]) * n
    return Contact("cushion", t, (k,), (), cushion), (segment.state, after)


def _slip_after_sticking(approach_speed: float, exit_speed: float) -> float:
    """Return the slip along the normal, m/s, after a nose that sticks, as in `joint_fit.physics_priors`."""
    return exit_speed - (1 - CUSHION_RESTITUTION[0]) * approach_speed
