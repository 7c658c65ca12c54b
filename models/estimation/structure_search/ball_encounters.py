"""Ball contacts proposed where two fitted paths come near each other, and those that follow from others or are false.

Wherever paths pass within reach, a contact is tried: the segments around it are refined with and without it, and it is
kept if its gain in chi2 exceeds its price. A velocity change nearby that had no cause, or another one, becomes part of
the contact.

Contacts that follow from one within a few frames are inserted together: a ball that runs into another one which lies
against a third seems to stop while the third starts; the one between hardly moves. With the first contact alone, the
following motion has no cause, or the paths are bent.

In a break one ball seems to meet another where several met within a frame interval. The contact laws then bend both
paths for their whole duration: such a contact is replaced by unexplained changes until a better cause is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import Contact, ContactGraph, JointSolution
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import (
    MIN_CONTACT_SPEED,
    CascadeContact,
    find_unexplained_change,
    insert_cascade,
    predict_cascade,
)
from models.estimation.joint_fit.fit_solution import assign_observations, evaluate_residuals
from models.estimation.joint_fit.trust_level import evaluate_segment_chi2
from models.estimation.segmentation.contact_classification import BALL_TOLERANCE
from models.estimation.structure_search.structure_trials import StructureSearch, copy_refined_states, separate_balls
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# s between the evaluated distances; a ball at 5 m/s moves a third of its radius.
TIME_STEP = 2e-3
# Frame intervals: a velocity change so near to a contact may be its effect.
TIME_TOLERANCE = 1.2
# Successive rounds: one contact often reveals the next.
MAX_INSERTION_ROUNDS = 6


@dataclass(frozen=True, slots=True)
class NearPass:
    """Balls a and b come within reach of each other, nearest at t, s."""

    a: int
    b: int
    t: float


@dataclass(frozen=True, slots=True)
class ContactProposal:
    """Proposed contacts, and the gain in chi2 of the segments that they change, minus their prices."""

    contacts: list[CascadeContact]
    gain: float
    segments: frozenset[int]
    """Segments of the graph that change."""
    subgraph: ContactGraph
    """These segments, in order, and the new ones, refined by themselves."""


def insert_passing_contacts(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Insert contacts of passing balls as long as new ones come up."""
    changed: frozenset[int] | None = None
    for _ in range(MAX_INSERTION_ROUNDS):
        proposals = _find_ball_contacts(solution, search, changed)
        solution, changed = _insert_paying_proposals(solution, proposals, search)
        if not changed:
            break
    return solution


def _insert_paying_proposals(
    solution: JointSolution, proposals: list[ContactProposal], search: StructureSearch
) -> tuple[JointSolution, frozenset[int]]:
    """Insert the proposals that lower the total cost of the clip; return also the segments that changed.

    If all together do not, half of them are tried, then the others: a contact that is right locally may be wrong for
    what comes before or after.
    """
    extended, changed = _insert_proposals(solution, proposals, search)
    if not changed:
        return solution, changed
    trial = search.refine(extended, solution)
    if search.cost(trial) < search.cost(solution):
        return trial, changed
    if len(proposals) == 1:
        return solution, frozenset()
    half = len(proposals) // 2
    solution, one = _insert_paying_proposals(solution, proposals[:half], search)
    rest = [other for other in proposals[half:] if not other.segments & one]
    solution, two = _insert_paying_proposals(solution, rest, search)
    return solution, one | two


def _find_ball_contacts(
    solution: JointSolution, search: StructureSearch, changed: frozenset[int] | None
) -> list[ContactProposal]:
    """Find the ball contacts that gain more than their price locally, the best first.

    No trial is repeated while nothing changes. If `changed` segments are given, only passes of these are tried.
    """
    owner = assign_observations(solution.graph, search.observations)
    base_costs: dict[frozenset[int], float] = {}
    proposals = []
    for near_pass in _find_near_passes(solution, search):
        for contacts in _propose_contacts(solution, search, near_pass):
            extended = insert_cascade(
                solution.graph, search.observations, owner, contacts, TIME_TOLERANCE * search.interval
            )
            if extended is not None:
                proposals += _evaluate_proposal(solution, search, extended, contacts, base_costs, changed)
    return sorted(proposals, key=lambda one: -one.gain)


def _evaluate_proposal(
    solution: JointSolution,
    search: StructureSearch,
    extended: ContactGraph,
    contacts: list[CascadeContact],
    base_costs: dict[frozenset[int], float],
    changed: frozenset[int] | None,
) -> list[ContactProposal]:
    """Evaluate contacts of an extended graph; none if they do not pay, or concern unchanged segments alone."""
    new_segments = frozenset(range(len(solution.graph.segments), len(extended.segments)))
    moments = {contact.t for contact in contacts}
    new_contacts = [item for item in extended.contacts if item.kind == "ball" and item.t in moments]
    region = frozenset(k for item in new_contacts for k in (*item.before, *item.after)) - new_segments
    if changed is not None and not region & changed:
        return []
    key = (len(contacts), *extended.cache_key(sorted(region | new_segments)))
    if key not in search.trials:
        trial = search.evaluate_extension(solution, extended, region, base_costs)
        if trial is None:
            return []
        search.trials[key] = trial
    gain, subgraph = search.trials[key]
    return [ContactProposal(contacts, gain, region, subgraph)] if gain > 0 else []


def _insert_proposals(
    solution: JointSolution, proposals: list[ContactProposal], search: StructureSearch
) -> tuple[ContactGraph, frozenset[int]]:
    """Insert the proposals that do not touch a better one; return also the segments that changed."""
    observations, graph, changed = search.observations, solution.graph, frozenset[int]()
    owner = assign_observations(graph, observations)
    for proposal in proposals:
        if proposal.segments & changed:
            continue
        extended = insert_cascade(graph, observations, owner, proposal.contacts, TIME_TOLERANCE * search.interval)
        if extended is not None:
            new_segments = range(len(graph.segments), len(extended.segments))
            changed |= proposal.segments | frozenset(new_segments)
            graph = copy_refined_states(extended, proposal.subgraph, [*sorted(proposal.segments), *new_segments])
    return graph.mark_pushed_strikes(), changed


def _find_near_passes(solution: JointSolution, search: StructureSearch) -> list[NearPass]:
    """Find where two balls, one of them in motion, come within reach without a contact in the graph."""
    graph, observations, interval, radius = (
        solution.graph,
        search.observations,
        search.interval,
        search.table.ball_radius,
    )
    balls = np.unique(observations.ball)
    t = np.arange(float(observations.t.min()), float(observations.t.max()), TIME_STEP)
    residual = evaluate_residuals(solution, observations)
    paths = {ball: _path_from_samples(solution, search, residual, ball, t) for ball in balls.tolist()}
    changes = {ball: _times_of_unexplained_changes(graph, ball) for ball in balls.tolist()}
    reach = 2 * radius * solution.diameter_factor + BALL_TOLERANCE * radius
    passes = []
    for i, a in enumerate(balls[:-1].tolist()):
        for b in balls[i + 1 :].tolist():
            moving = paths[a][1] | paths[b][1]
            distance = np.linalg.norm(paths[a][0] - paths[b][0], axis=1)
            is_within = np.nan_to_num(distance, nan=np.inf) < reach
            contact_times = [c.t for c in graph.contacts if c.kind == "ball" and graph.balls_at(c) == {a, b}]
            for first, end in _find_runs(is_within):
                rows = np.arange(first, end)[moving[first:end]]
                moments = [float(t[rows[np.argmin(distance[rows])]])] if len(rows) else []
                early, late = t[first] - interval, t[end - 1] + interval
                moments += [m for m in changes[a] + changes[b] if early < m < late]
                for moment in sorted(moments):
                    if all(abs(m - moment) >= TIME_TOLERANCE * interval for m in contact_times):
                        contact_times.append(moment)
                        passes.append(NearPass(a, b, moment))
    return passes


def _propose_contacts(
    solution: JointSolution, search: StructureSearch, near_pass: NearPass
) -> list[list[CascadeContact]]:
    """Propose the contact of two balls alone, and with the cascade that it starts, if any."""
    graph, radius = solution.graph, search.table.ball_radius * solution.diameter_factor
    unexplained = (
        find_unexplained_change(graph, ball, near_pass.t, TIME_TOLERANCE * search.interval)
        for ball in (near_pass.a, near_pass.b)
    )
    times = [graph.contacts[number].t for number in unexplained if number is not None]
    t = float(np.mean(times)) if times else near_pass.t
    contacts = predict_cascade(graph, solution.friction, near_pass.a, near_pass.b, t, search.interval, radius)
    return [contacts[:1], contacts] if len(contacts) > 1 else [contacts]


def _path_from_samples(
    solution: JointSolution, search: StructureSearch, residual: FloatArray, ball: int, t: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return places (M, 2) of a ball, NaN where it was not tracked, and whether it moves (M,).

    The fitted path is shifted to the samples by its `residual` (K, 2) m, because it is wrong where a contact is
    missing.
    """
    graph, is_own = solution.graph, search.observations.ball == ball
    times = search.observations.t[is_own]
    segments = graph.segments_of_ball(ball)
    starts = np.array([graph.start_time(k) for k in segments])
    row = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, None)
    states = np.array([graph.segments[k].state for k in segments])[row]
    static = np.array([graph.segments[k].static for k in segments])[row]
    path = evaluate_kinematics(states, np.maximum(t - starts[row], 0.0), solution.friction)
    xy = np.where(static[:, None], states[:, :2], path[:, :2])
    xy = xy + np.stack([np.interp(t, times, residual[is_own, axis]) for axis in (0, 1)], axis=1)
    is_observed = (t >= times[0]) & (t <= times[-1])
    is_moving = ~static & (np.linalg.norm(path[:, 2:4], axis=1) > MIN_CONTACT_SPEED)
    return np.where(is_observed[:, None], xy, np.nan), is_moving


def _times_of_unexplained_changes(graph: ContactGraph, ball: int) -> list[float]:
    """List the times, s, of a ball's velocity changes that neither a ball nor a cushion causes."""
    return [c.t for c in graph.contacts if c.kind in ("free", "strike") and graph.segments[c.before[0]].ball == ball]


def _find_runs(is_within: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and end of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_within.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


# Frame intervals after a contact in which it may set balls in motion.
HORIZONS = (1.0, 2.5)
# chi2 per degree of freedom of a path that one more contact may improve, and of one that its contacts bend.
IMPROVABLE_CHI2, BENT_CHI2 = 1.5, 3.0
# Trials of chains in one round, and removals, the most bent first.
MAX_CHAINS, MAX_REMOVALS = 6, 3


def complete_chains(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Complete the chains of ball contacts where the total cost of the clip falls."""
    trial_count = 0
    for contact in _find_suspicious_contacts(solution, search):
        for horizon in HORIZONS:
            number = next((k for k, one in enumerate(solution.graph.contacts) if one == contact), None)
            if number is None or trial_count >= MAX_CHAINS:
                break
            key = (horizon, *sorted(solution.graph.balls_at(contact)), round(contact.t, 2))
            extended = None if key in search.required else _insert_chain(solution, search, number, horizon)
            if extended is None:
                continue
            trial_count += 1
            better = search.refine_if_cheaper(extended, solution)
            if better is None:
                search.required.add(key)
            solution = better or solution
    return solution


def _rate_ball_contacts(solution: JointSolution, search: StructureSearch) -> dict[int, float]:
    """Return the largest chi2 per degree of freedom of the segments at each ball contact."""
    chi2 = np.nan_to_num(evaluate_segment_chi2(solution, search.observations)[0], nan=0.0)
    return {
        number: float(chi2[[*contact.before, *contact.after]].max())
        for number, contact in enumerate(solution.graph.contacts)
        if contact.kind == "ball"
    }


def _find_suspicious_contacts(solution: JointSolution, search: StructureSearch) -> list[Contact]:
    """Find ball contacts beside an unexplained start, or with bent paths, the worst first."""
    contacts, reach = solution.graph.contacts, TIME_TOLERANCE * search.interval
    unexplained_times = np.array([c.t for c in contacts if c.kind == "free" or c.pushed])
    suspicious = []
    for number, worst_chi2 in _rate_ball_contacts(solution, search).items():
        t = contacts[number].t
        is_beside_unexplained = bool(len(unexplained_times) and np.abs(unexplained_times - t).min() < reach)
        if is_beside_unexplained or worst_chi2 > IMPROVABLE_CHI2:
            suspicious.append((-worst_chi2 - 10.0 * is_beside_unexplained, t, number))
    return [contacts[number] for *_, number in sorted(suspicious)]


def _insert_chain(solution: JointSolution, search: StructureSearch, number: int, horizon: float) -> ContactGraph | None:
    """Insert what follows from a contact; None if the graph already contains it."""
    graph, interval = solution.graph, search.interval
    contact = graph.contacts[number]
    a, b = (graph.segments[k].ball for k in contact.before)
    reduced = graph.remove_contact(number)
    radius = search.table.ball_radius * solution.diameter_factor
    contacts = predict_cascade(reduced, solution.friction, a, b, contact.t, horizon * interval, radius)
    known_contacts = [(c.t, graph.balls_at(c)) for c in graph.contacts if c.kind == "ball"]
    if all(_is_in_graph(item, known_contacts, 2 * horizon * interval) for item in contacts[1:]):
        return None
    owner = assign_observations(reduced, search.observations)
    extended = insert_cascade(reduced, search.observations, owner, contacts, TIME_TOLERANCE * interval)
    return None if extended is None else extended.mark_pushed_strikes()


def _is_in_graph(contact: CascadeContact, known_contacts: list[tuple[float, set[int]]], time_tolerance: float) -> bool:
    """Return whether a contact of the same balls is in the graph at about that time."""
    return any(balls == {contact.a, contact.b} and abs(t - contact.t) < time_tolerance for t, balls in known_contacts)


def remove_false_contacts(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Remove ball contacts with bent paths where two unexplained changes cost less."""
    worst = _rate_ball_contacts(solution, search)
    for number in sorted(worst, key=lambda number: -worst[number])[:MAX_REMOVALS]:
        contact = solution.graph.contacts[number]
        key = (*sorted(solution.graph.balls_at(contact)), round(contact.t, 2))
        if worst[number] < BENT_CHI2 or key in search.required:
            continue
        better = search.refine_if_cheaper(separate_balls(solution.graph, number), solution)
        if better is None:
            search.required.add(key)
        solution = better or solution
    return solution
