"""Ball contacts proposed where two fitted paths come near each other.

Wherever paths pass within reach, a contact is tried: the segments around it are refined with and without it, and it is
kept if its gain in chi2 exceeds its price. A velocity change nearby that had no cause, or another one, becomes part of
the contact.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.contact_cascades import (
    MIN_CONTACT_INTERVAL,
    MIN_CONTACT_SPEED,
    CascadeContact,
    find_unexplained_change,
    insert_cascade,
    predict_cascade,
)
from models.estimation.joint_fit.fit_solution import assign_observations, end_state, evaluate_residuals
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.segmentation.contact_classification import BALL_TOLERANCE, INWARD_NORMALS
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# s between the evaluated distances; a ball at 5 m/s moves a third of its radius.
TIME_STEP = 2e-3
# Frame intervals: a velocity change so near to a contact may be its effect.
TIME_TOLERANCE = 1.2
LOCAL_ITERATIONS = 12


@dataclass(frozen=True, slots=True)
class SearchCache:
    """Results of earlier trials, by the situation they were evaluated in."""

    gains: dict[tuple[Hashable, ...], float] = field(default_factory=dict)
    """chi2 that contacts of a graph improve."""
    trials: dict[tuple[Hashable, ...], tuple[float, ContactGraph]] = field(default_factory=dict)
    """chi2 that proposed contacts gain, minus their prices, and the segments that they change, refined by themselves.
    """
    required: set[tuple[Hashable, ...]] = field(default_factory=set)
    """Contacts that the whole clip needs unchanged: the balls, and the time to a hundredth of a second."""


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


def find_ball_contacts(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float], cache: SearchCache,
    changed: frozenset[int] | None = None,
) -> list[ContactProposal]:  # fmt: skip
    """Find the ball contacts that gain more than their price locally, the best first.

    `prices` are those of contacts with a cause and without; `cache` keeps the trials, so that none is repeated while
    nothing changes. If `changed` segments are given, only passes of these are tried.
    """
    interval, owner = observations.frame_interval, assign_observations(solution.graph, observations)
    base_costs: dict[frozenset[int], float] = {}
    trials = []
    time_tolerance = TIME_TOLERANCE * interval
    for near_pass in find_near_passes(solution, observations, table):
        for contacts in _propose_contacts(solution, table, near_pass, interval):
            extended = insert_cascade(solution.graph, observations, owner, contacts, time_tolerance)
            trial = (
                None
                if extended is None
                else _evaluate_proposal(
                    solution, observations, owner, table, extended, contacts, prices, base_costs, cache, changed
                )
            )
            if trial is not None and trial.gain > 0:
                trials.append(trial)
    return sorted(trials, key=lambda trial: -trial.gain)


def insert_proposals(
    solution: JointSolution, observations: Observations, proposals: list[ContactProposal], time_tolerance: float
) -> tuple[ContactGraph, frozenset[int]]:
    """Insert the proposals that do not touch a better one; return also the segments that changed."""
    graph, changed, owner = solution.graph, frozenset[int](), assign_observations(solution.graph, observations)
    for proposal in proposals:
        if proposal.segments & changed:
            continue
        extended = insert_cascade(graph, observations, owner, proposal.contacts, time_tolerance)
        if extended is not None:
            new_segments = range(len(graph.segments), len(extended.segments))
            changed |= proposal.segments | frozenset(new_segments)
            graph = copy_refined_states(extended, proposal.subgraph, [*sorted(proposal.segments), *new_segments])
    return graph.mark_pushed_strikes(), changed


def copy_refined_states(graph: ContactGraph, subgraph: ContactGraph, segments: list[int]) -> ContactGraph:
    """Copy states and times of a refined subgraph, which has the segments `segments`; no change if they do not fit."""
    states, contacts = list(graph.segments), list(graph.contacts)
    for k, refined in zip(segments, subgraph.segments, strict=True):
        if states[k].static == refined.static:
            states[k] = replace(states[k], state=refined.state)
    for contact in subgraph.contacts:
        number = states[segments[contact.before[0]]].end
        if number is not None:
            contacts[number] = replace(contacts[number], t=contact.t)
    updated = ContactGraph(tuple(states), tuple(contacts))
    is_ordered = all(updated.end_time(k) > updated.start_time(k) + MIN_CONTACT_INTERVAL for k in range(len(states)))
    return updated if is_ordered else graph


def find_near_passes(solution: JointSolution, observations: Observations, table: Table) -> list[NearPass]:
    """Find where two balls, one of them in motion, come within reach without a contact in the graph."""
    graph, interval = solution.graph, observations.frame_interval
    balls = np.unique(observations.ball)
    t = np.arange(float(observations.t.min()), float(observations.t.max()), TIME_STEP)
    residual = evaluate_residuals(solution, observations)
    paths = {int(ball): _path_from_samples(solution, observations, residual, int(ball), t) for ball in balls}
    changes = {int(ball): _times_of_unexplained_changes(graph, int(ball)) for ball in balls}
    reach = 2 * table.ball_radius * solution.diameter_factor + BALL_TOLERANCE * table.ball_radius
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
                    recorded = [m for m in contact_times if abs(m - moment) < TIME_TOLERANCE * interval]
                    if not recorded:
                        contact_times.append(moment)
                        passes.append(NearPass(a, b, moment))
    return passes


def _propose_contacts(
    solution: JointSolution, table: Table, near_pass: NearPass, interval: float
) -> list[list[CascadeContact]]:
    """Propose the contact of two balls alone, and with the cascade that it starts, if any."""
    graph, radius = solution.graph, table.ball_radius * solution.diameter_factor
    unexplained = (
        find_unexplained_change(graph, ball, near_pass.t, TIME_TOLERANCE * interval)
        for ball in (near_pass.a, near_pass.b)
    )
    times = [graph.contacts[number].t for number in unexplained if number is not None]
    t = float(np.mean(times)) if times else near_pass.t
    contacts = predict_cascade(graph, solution.friction, near_pass.a, near_pass.b, t, interval, radius)
    return [contacts[:1], contacts] if len(contacts) > 1 else [contacts]


def is_doubtful(solution: JointSolution, contact: Contact) -> bool:
    """Return whether a contact has no cause, or is so slow that a bent path would do as well."""
    if contact.kind == "ball" and not contact.driven:
        return closing_speed(solution, contact) < MIN_CONTACT_SPEED
    if contact.kind == "cushion":
        return bool(
            -INWARD_NORMALS[CUSHIONS.index(contact.cushion)] @ end_state(solution, contact.before[0])[2:4]
            < MIN_CONTACT_SPEED
        )
    return contact.kind in ("free", "jump") or contact.pushed


def closing_speed(solution: JointSolution, contact: Contact) -> float:
    """Return the speed at which two balls approach each other, m/s."""
    one, two = (end_state(solution, k) for k in contact.before)
    separation = two[:2] - one[:2]
    return float((one[2:4] - two[2:4]) @ separation) / max(float(np.hypot(*separation)), 1e-9)


def _evaluate_proposal(
    solution: JointSolution,
    observations: Observations,
    owner: IntArray,
    table: Table,
    extended: ContactGraph,
    contacts: list[CascadeContact],
    prices: tuple[float, float],
    base_costs: dict[frozenset[int], float],
    cache: SearchCache,
    changed: frozenset[int] | None,
) -> ContactProposal | None:
    """Evaluate the gain of an extended graph where it differs; None if only unchanged segments are concerned."""
    graph = solution.graph
    new_segments = frozenset(range(len(graph.segments), len(extended.segments)))
    moments = {contact.t for contact in contacts}
    new_contacts = [item for item in extended.contacts if item.kind == "ball" and item.t in moments]
    region = frozenset(k for item in new_contacts for k in (*item.before, *item.after)) - new_segments
    rows = np.isin(owner, list(region))
    if not rows.any() or (changed is not None and not region & changed):
        return None
    key = (len(contacts), *extended.cache_key(sorted(region | new_segments)))
    if key not in cache.trials:
        local = observations.select_rows(rows)
        if region not in base_costs:
            base_costs[region] = total_cost(refine_subgraph(solution, graph, sorted(region), local, table), prices)
        refined = refine_subgraph(solution, extended, sorted(region | new_segments), local, table)
        cache.trials[key] = base_costs[region] - total_cost(refined, prices), refined.graph
    return ContactProposal(contacts, cache.trials[key][0], region, cache.trials[key][1])


def refine_subgraph(
    solution: JointSolution, graph: ContactGraph, segments: list[int], local: Observations, table: Table
) -> JointSolution:
    """Refine some segments of a graph and the contacts among them by themselves."""
    return refine_graph(graph.select_segments(segments), local, table, iterations=LOCAL_ITERATIONS, initial=solution)


def total_cost(solution: JointSolution, prices: tuple[float, float]) -> float:
    """Return the chi2 of a solution plus the prices of its contacts."""
    doubtful = sum(is_doubtful(solution, c) for c in solution.graph.contacts)
    return solution.chi2 + doubtful * prices[1] + (len(solution.graph.contacts) - doubtful) * prices[0]


def _path_from_samples(
    solution: JointSolution, observations: Observations, residual: FloatArray, ball: int, t: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return places (M, 2) of a ball, NaN where it was not tracked, and whether it moves (M,).

    The fitted path is shifted to the samples by its `residual` (K, 2) m, because it is wrong where a contact is
    missing.
    """
    graph, is_own = solution.graph, observations.ball == ball
    times = observations.t[is_own]
    segments = graph.segments_of_ball(ball)
    starts = np.array([graph.start_time(k) for k in segments])
    chosen = np.array(segments)[np.clip(np.searchsorted(starts, t, side="right") - 1, 0, None)]
    states = np.array([segment.state for segment in graph.segments])[chosen]
    static = np.array([segment.static for segment in graph.segments])[chosen]
    tau = np.maximum(t - np.array([graph.start_time(k) for k in range(len(graph.segments))])[chosen], 0.0)
    path = evaluate_kinematics(states, tau, solution.friction)
    xy = np.where(static[:, None], states[:, :2], path[:, :2])
    xy = xy + np.stack([np.interp(t, times, residual[is_own, axis]) for axis in (0, 1)], axis=1)
    is_observed = (t >= times[0]) & (t <= times[-1])
    return np.where(is_observed[:, None], xy, np.nan), ~static & (
        np.linalg.norm(path[:, 2:4], axis=1) > MIN_CONTACT_SPEED
    )


def _times_of_unexplained_changes(graph: ContactGraph, ball: int) -> list[float]:
    """List the times, s, of a ball's velocity changes that neither a ball nor a cushion causes."""
    return [c.t for c in graph.contacts if c.kind in ("free", "strike") and graph.segments[c.before[0]].ball == ball]


def _find_runs(is_within: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and end of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_within.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
