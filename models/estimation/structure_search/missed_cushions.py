"""Missed cushion contacts, and rebounds in a wrong local minimum.

Paths run through a missed cushion or turn back for no cause. A rebound can be wrong since small steps no longer find a
slip that ends within a frame or two.

A ball that runs into a corner meets two cushions within a frame or two, one that is hit beside a rail comes back from
it at once: too few samples lie between to show a velocity change. Such a pair looks like one contact, which no law
explains: a cushion contact is tried on either side of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, JointSolution
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import end_state, evaluate_path
from models.estimation.joint_fit.pseudo_observations import CUSHION_RESTITUTION
from models.estimation.segmentation.contact_classification import CUSHION_TOLERANCE, INWARD_NORMALS, cushion_distances
from models.estimation.structure_search.structure_trials import StructureSearch, copy_refined_states
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# Ball radii: a path that goes so far into a cushion has met it.
OVERSHOOT_RADII = 0.2
# Change of the velocity across a guessed rebound, over the velocity towards the cushion: three quarters come back.
REBOUND = 1.75

# `JointSolution.rubber` of the two extreme noses: a mirror law's and Mathavan's.
SLIPPING, STICKING = (np.array([CUSHION_RESTITUTION[0], 0.0, grip]) for grip in (0.0, 1.0))


def refit_rebounds(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Refit a graph also from rebounds off noses that slip or stick, and select the solution of least chi2.

    A ball that leaves a cushion slides for a tenth of a second. Where three frames show it, a slow ball that rolls at
    once fits them nearly as well, and no small step leads from the one to the other.
    """
    if not any(contact.kind == "cushion" for contact in solution.graph.contacts):
        return solution
    starts = [_set_rebounds(solution, rubber) for rubber in (SLIPPING, STICKING)]
    trials = [search.refine(start.graph, start) for start in starts]
    return min([solution, *trials], key=lambda one: one.chi2)


def _set_rebounds(solution: JointSolution, rubber: FloatArray) -> JointSolution:
    """Set the velocities and slips along the normal with which balls leave cushions of `rubber` (3,)."""
    graph, (restitution, restitution_slope, grip) = solution.graph, rubber
    for contact in solution.graph.contacts:
        k = contact.after[0]
        if contact.kind != "cushion" or graph.segments[k].static:
            continue
        n, before = INWARD_NORMALS[CUSHIONS.index(contact.cushion)], end_state(solution, contact.before[0])
        approach_velocity, slip = float(n @ before[2:4]), float(n @ before[4:6])
        exit_velocity = (restitution - restitution_slope * approach_velocity) * -approach_velocity
        stopped_slip = grip * (slip - restitution * approach_velocity)  # as in `pseudo_observations`
        state = graph.segments[k].state.copy()
        _set_normal_motion(state, n, exit_velocity, slip + (exit_velocity - approach_velocity) - stopped_slip)
        state[6:8] = 0.0
        graph = graph.replace_segment(k, replace(graph.segments[k], state=state))
    return replace(solution, graph=graph, nose_offsets=np.zeros(4), rubber=rubber.copy())


def _set_normal_motion(state: FloatArray, n: FloatArray, velocity: float, slip: float) -> None:
    """Set velocity and slip along the normal `n` (2,) of a cushion, m/s, in a state (8,)."""
    state[2:4] += (velocity - n @ state[2:4]) * n
    state[4:6] += (slip - n @ state[4:6]) * n


def classify_cushion_turns(solution: JointSolution, search: StructureSearch, time_error: float = 0.0) -> ContactGraph:
    """Classify unexplained velocity changes that are beside a cushion.

    Args:
        solution: A refined solution.
        search: Table.
        time_error: s by which a turn may be misplaced along the path.

    Returns:
        The graph with these changes as cushion contacts; the same object where there is none.
    """
    graph = solution.graph
    for number, contact in enumerate(graph.contacts):
        if contact.kind == "free":
            side = _find_reversing_cushion(solution, contact, search.table, time_error=time_error)
            if side is not None:
                graph = graph.replace_contact(number, replace(contact, kind="cushion", cushion=CUSHIONS[side]))
    return graph


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
        t = min(contact.t + 2e-3, graph.end_time(contact.after[0]) - 1e-3)
        if t > contact.t + 2e-4:
            extra = Contact("cushion", t, (contact.after[0],), (), CUSHIONS[second], gain=contact.gain)
            cut = graph.replace_segment(contact.after[0], replace(graph.segments[contact.after[0]], state=middle))
            graph = cut.insert_contact(extra, (after,))
    return graph


def insert_crossed_cushions(solution: JointSolution, search: StructureSearch) -> ContactGraph:
    """Insert contacts with cushions that paths run through."""
    graph, observations, table = solution.graph, search.observations, search.table
    last = {int(ball): float(observations.t[observations.ball == ball].max()) for ball in np.unique(observations.ball)}
    for k, segment in enumerate(solution.graph.segments):
        if segment.static:
            continue
        begin, end = graph.start_time(k), min(graph.end_time(k), last[segment.ball])
        if end - begin < 1e-3:
            continue
        t = np.linspace(begin, end, max(int((end - begin) / 1e-3), 8))
        path = evaluate_path(solution.graph, solution.friction, k, t)
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


def insert_corner_cushions(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Insert the cushion contacts beside other contacts that lower the total cost of the clip."""
    trials = []
    base_costs: dict[frozenset[int], float] = {}
    for corner in _propose_corners(solution, search.table, MAX_CORNER_INTERVALS * search.interval):
        region = _segments_around(solution.graph, corner.around)
        trial = search.evaluate_extension(solution, _insert_corner(solution.graph, corner), region, base_costs)
        if trial is not None:
            trials.append((*trial, corner))
    changed: frozenset[int] = frozenset()
    for gain, subgraph, corner in sorted(trials, key=lambda trial: -trial[0])[:MAX_TRIALS]:
        region, new = _segments_around(solution.graph, corner.around), len(solution.graph.segments)
        if gain <= 0 or changed & region:
            continue
        extended = _insert_corner(solution.graph, corner)
        refined = copy_refined_states(extended, subgraph, [*sorted(region), new]).mark_pushed_strikes()
        candidate = search.refine(refined, solution)
        if search.cost(candidate) < search.cost(solution):
            solution, changed = candidate, changed | region | {new}
    return solution


def _segments_around(graph: ContactGraph, contact: int) -> frozenset[int]:
    """Return the segments that meet at a contact."""
    return frozenset((*graph.contacts[contact].before, *graph.contacts[contact].after))


def _insert_corner(graph: ContactGraph, corner: _CornerCandidate) -> ContactGraph:
    """Insert a candidate into the graph."""
    k, (before, after) = corner.contact.before[0], corner.states
    cut = graph.replace_segment(k, replace(graph.segments[k], state=before))
    return cut.insert_contact(corner.contact, (after,))


def _propose_corners(solution: JointSolution, table: Table, max_time: float) -> list[_CornerCandidate]:
    """Propose cushion contacts less than `max_time` s before or after other contacts."""
    candidates = []
    for number, contact in enumerate(solution.graph.contacts):
        if contact.kind in ("jump", "break"):
            continue
        for before, after in zip(contact.before, contact.after, strict=True):
            position = solution.graph.segments[after].state[:2]
            beyond = cushion_distances(position, table) - table.ball_radius - solution.nose_offsets
            for side in np.flatnonzero(beyond > -0.5 * CUSHION_TOLERANCE * table.ball_radius).tolist():
                distance = max(float(beyond[side]), 0.0)
                if contact.kind != "cushion" or contact.cushion != CUSHIONS[side]:
                    for propose, k in ((_propose_cushion_after, after), (_propose_cushion_before, before)):
                        proposal = propose(solution, k, side, distance, max_time)
                        candidates += [] if proposal is None else [_CornerCandidate(*proposal, number)]
    return candidates


def _propose_cushion_after(
    solution: JointSolution, k: int, side: int, distance: float, max_time: float
) -> tuple[Contact, tuple[FloatArray, FloatArray]] | None:
    """Propose that segment k meets a cushion `distance` m away after its start.

    Without it the segment moves away from the cushion, or spin turns it.
    """
    segment, graph, n = solution.graph.segments[k], solution.graph, INWARD_NORMALS[side]
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
    _set_normal_motion(middle, n, approach_speed, approach_speed)  # without spin: its slip is its velocity
    after[:2] -= (later - wait) * later_state[2:4]
    after[:2] += (n @ (segment.state[:2] - after[:2]) - distance) * n
    after[4:6] += (_slip_after_sticking(approach_speed, exit_speed) - n @ after[4:6]) * n
    return Contact("cushion", begin + wait, (k,), (), CUSHIONS[side]), (middle, after)


def _propose_cushion_before(
    solution: JointSolution, k: int, side: int, distance: float, max_time: float
) -> tuple[Contact, tuple[FloatArray, FloatArray]] | None:
    """Propose that segment k meets a cushion `distance` m away before its end, where it still runs towards it."""
    segment, graph, n = solution.graph.segments[k], solution.graph, INWARD_NORMALS[side]
    approach_speed = float(n @ end_state(solution, k)[2:4])
    if segment.static or approach_speed > -MIN_CONTACT_SPEED:
        return None
    exit_speed = -CUSHION_RESTITUTION[0] * approach_speed
    time_before_end = max(distance / exit_speed, 2 * MIN_CONTACT_INTERVAL)
    t = graph.end_time(k) - time_before_end
    if time_before_end > max_time or t < graph.start_time(k) + 2 * MIN_CONTACT_INTERVAL:
        return None
    after = np.concatenate([evaluate_path(graph, solution.friction, k, np.array([t]))[0], np.zeros(2)])
    _set_normal_motion(after, n, exit_speed, _slip_after_sticking(approach_speed, exit_speed))
    return Contact("cushion", t, (k,), (), CUSHIONS[side]), (segment.state, after)


def _slip_after_sticking(approach_speed: float, exit_speed: float) -> float:
    """Return the slip along the normal, m/s, after a nose that sticks, as in `joint_fit.pseudo_observations`."""
    return exit_speed - (1 - CUSHION_RESTITUTION[0]) * approach_speed
