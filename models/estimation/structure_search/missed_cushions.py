"""Missed cushion contacts, and rebounds in a wrong local minimum.

Paths run through a missed cushion or turn back for no cause. A rebound can be wrong since small steps no longer find a
slip that ends within a frame or two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import end_state
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.joint_fit.prior_residuals import CUSHION_RESTITUTION
from models.estimation.segmentation.contact_classification import CUSHION_TOLERANCE, INWARD_NORMALS, cushion_distances
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# Ball radii: a path that goes so far into a cushion has met it.
OVERSHOOT_RADII = 0.2
# Change of the velocity across a guessed rebound, over the velocity towards the cushion: three quarters come back.
REBOUND = 1.75

# `JointSolution.rubber` of the two extreme noses: a mirror law's and Mathavan's.
SLIPPING, STICKING = (np.array([CUSHION_RESTITUTION[0], 0.0, grip]) for grip in (0.0, 1.0))


def refit_rebounds(solution: JointSolution, observations: Observations, table: Table) -> JointSolution:
    """Refit a graph also from rebounds off noses that slip or stick, and select the best solution.

    A ball that leaves a cushion slides for a tenth of a second. Where three frames show it, a slow ball that rolls at
    once fits them nearly as well, and no small step leads from the one to the other.

    Args:
        solution: A refined solution.
        observations: K observations.

    Returns:
        The solution of least chi2.
    """
    if not any(contact.kind == "cushion" for contact in solution.graph.contacts):
        return solution
    starts = [_set_rebounds(solution, rubber) for rubber in (SLIPPING, STICKING)]
    trials = [refine_graph(start.graph, observations, table, initial=start) for start in starts]
    return min([solution, *trials], key=lambda one: one.chi2)


def _set_rebounds(solution: JointSolution, rubber: FloatArray) -> JointSolution:
    """Set the velocities and slips along the normal with which balls leave cushions of `rubber` (3,)."""
    graph, (restitution, restitution_slope, grip) = solution.graph, rubber
    segments = list(graph.segments)
    for contact in graph.contacts:
        if contact.kind != "cushion" or segments[contact.after[0]].static:
            continue
        n, before = INWARD_NORMALS[CUSHIONS.index(contact.cushion)], end_state(solution, contact.before[0])
        approach_velocity, slip = float(n @ before[2:4]), float(n @ before[4:6])
        exit_velocity = (restitution - restitution_slope * approach_velocity) * -approach_velocity
        exit_slip = (
            slip + (exit_velocity - approach_velocity) - grip * (slip - restitution * approach_velocity)
        )  # as in `physics_priors`
        state = segments[contact.after[0]].state.copy()
        state[2:4] += (exit_velocity - n @ state[2:4]) * n
        state[4:6] += (exit_slip - n @ state[4:6]) * n
        state[6:8] = 0.0
        segments[contact.after[0]] = replace(segments[contact.after[0]], state=state)
    return replace(
        solution, graph=ContactGraph(tuple(segments), graph.contacts), nose_offsets=np.zeros(4), rubber=rubber.copy()
    )


def classify_cushion_turns(solution: JointSolution, table: Table, time_error: float = 0.0) -> ContactGraph:
    """Classify unexplained velocity changes that are beside a cushion.

    Args:
        solution: A refined solution.
        time_error: s by which a turn may be misplaced along the path.

    Returns:
        The graph with these changes as cushion contacts; the same object where there is none.
    """
    contacts = list(solution.graph.contacts)
    changed = False
    for number, contact in enumerate(contacts):
        if contact.kind != "free":
            continue
        side = _find_reversing_cushion(solution, contact, table, time_error=time_error)
        if side is not None:
            contacts[number] = replace(contact, kind="cushion", cushion=CUSHIONS[side])
            changed = True
    return ContactGraph(solution.graph.segments, tuple(contacts)) if changed else solution.graph


def _find_reversing_cushion(
    solution: JointSolution, contact: Contact, table: Table, excluded: int = -1, time_error: float = 0.0
) -> int | None:
    """Find the cushion near which a ball turns back at a contact, other than `excluded`."""
    segments = solution.graph.segments
    before, after = end_state(solution, contact.before[0]), segments[contact.after[0]].state
    distance = cushion_distances(after[:2], table) - table.ball_radius - solution.nose_offsets
    reach = 0.5 * CUSHION_TOLERANCE * table.ball_radius
    for side in np.argsort(np.abs(distance)):
        towards, away = -INWARD_NORMALS[side] @ before[2:4], INWARD_NORMALS[side] @ after[2:4]
        if (
            side != excluded
            and abs(distance[side]) < reach + time_error * towards
            and towards > MIN_CONTACT_SPEED
            and away > 0
        ):
            return int(side)
    return None


def split_corner_contacts(solution: JointSolution, graph: ContactGraph, table: Table) -> ContactGraph:
    """Split cushion contacts in a corner, where a ball meets two cushions within one frame."""
    for contact, unchanged in zip(solution.graph.contacts, graph.contacts, strict=False):
        if contact.kind != "cushion" or contact != unchanged:  # an earlier step may have changed or shortened the graph
            continue
        first = CUSHIONS.index(contact.cushion)
        second = _find_reversing_cushion(solution, contact, table, excluded=first)
        if second is None:
            continue
        before = end_state(solution, contact.before[0])
        after = graph.segments[contact.after[0]].state.copy()
        middle = after.copy()  # between the two contacts only the first component has turned
        n = INWARD_NORMALS[second]
        middle[2:4] += (n @ before[2:4] - n @ after[2:4]) * n
        segments = list(graph.segments)
        segments[contact.after[0]] = replace(segments[contact.after[0]], state=middle)
        t = min(contact.t + 2e-3, graph.end_time(contact.after[0]) - 1e-3)
        if t > contact.t + 2e-4:
            extra = Contact("cushion", t, (contact.after[0],), (), CUSHIONS[second], gain=contact.gain)
            graph = ContactGraph(tuple(segments), graph.contacts).insert_contact(extra, (after,))
    return graph


def insert_crossed_cushions(
    solution: JointSolution, graph: ContactGraph, observations: Observations, table: Table
) -> ContactGraph:
    """Insert contacts with cushions that paths run through."""
    if graph is not solution.graph:
        return graph
    last = {int(ball): float(observations.t[observations.ball == ball].max()) for ball in np.unique(observations.ball)}
    for k, segment in enumerate(solution.graph.segments):
        if segment.static:
            continue
        begin, end = graph.start_time(k), min(graph.end_time(k), last[segment.ball])
        if end - begin < 1e-3:
            continue
        t = np.linspace(begin, end, max(int((end - begin) / 1e-3), 8))
        path = evaluate_kinematics(np.repeat(segment.state[None], len(t), axis=0), t - begin, solution.friction)
        depth = -(cushion_distances(path[:, :2], table) - table.ball_radius - solution.nose_offsets)  # (M, 4)
        side = int(np.argmax(depth.max(axis=0)))
        deepest = int(np.argmax(depth[:, side]))
        inwards = path[:, 2:4] @ INWARD_NORMALS[side]
        turns = (
            0 < deepest < len(t) - 1
            and -inwards[:deepest].min() > MIN_CONTACT_SPEED
            and inwards[deepest:].max() > MIN_CONTACT_SPEED
        )
        if turns and depth[deepest, side] > -2 * OVERSHOOT_RADII * table.ball_radius:
            depth[:, side] += max(-depth[deepest, side], 0.0) + 1e-4  # no ball turns back at a cushion by itself
        elif depth[deepest, side] < OVERSHOOT_RADII * table.ball_radius:
            continue
        if depth[0, side] > 0.5 * OVERSHOOT_RADII * table.ball_radius:
            continue
        if _is_in_pocket_mouth(path[int(np.argmax(depth[:, side])), :2], table):
            continue
        crossing = int(np.argmax(depth[:, side] > 0))
        if crossing in (0, len(t) - 1) or -INWARD_NORMALS[side] @ path[crossing, 2:4] < 0:
            continue
        contact = Contact("cushion", float(t[crossing]), (k,), (), CUSHIONS[side])
        graph = graph.insert_contact(contact, (guess_rebound(path[crossing], INWARD_NORMALS[side]),))
    return graph


def guess_rebound(state: FloatArray, inward: FloatArray) -> FloatArray:
    """Guess the state after a contact with a cushion, from which a refinement starts.

    Args:
        state: (6,) place, velocity and slip before the contact.
        inward: (2,) unit normal of the cushion.

    Returns:
        (8,) state of a segment that begins there; the velocity is that before where the ball moves away already.
    """
    after = np.concatenate([state, np.zeros(2)])
    push = -REBOUND * min(float(inward @ state[2:4]), 0.0) * inward
    after[2:4] += push
    after[4:6] += push
    return after


def _is_in_pocket_mouth(x: FloatArray, table: Table) -> bool:
    """Return whether a place is within three radii of a pocket, where there is no cushion."""
    return bool(
        len(table.pocket_centres) and np.linalg.norm(table.pocket_centres - x, axis=1).min() < 3 * table.ball_radius
    )
