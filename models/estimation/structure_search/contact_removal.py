"""Removal of false ball contacts: their velocity changes become unexplained until a better cause is found.

In a break one ball seems to meet another where several met within a frame interval. The contact laws then bend both
paths for their whole duration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, ContactKind, JointSolution, Observations
from models.core.scene import Table
from models.estimation.joint_fit.fit_solution import assign_observations
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.joint_fit.trust_level import evaluate_segment_chi2
from models.estimation.structure_search.ball_encounters import SearchCache, refine_subgraph, total_cost

# chi2 per degree of freedom of a path that its contacts bend.
BENT_CHI2 = 3.0
# Removals in one round, the most bent first.
MAX_REMOVALS = 3
# Iterations that show whether a graph deserves more of them.
TRIAL_ITERATIONS = 10


def remove_false_contacts(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float], cache: SearchCache
) -> JointSolution:
    """Remove ball contacts with bent paths where two unexplained changes cost less.

    `prices` are those of contacts with a cause and without; `cache` keeps the contacts that are not to be tried again.
    """
    chi2, _, _ = evaluate_segment_chi2(solution, observations)
    segment_chi2 = np.nan_to_num(chi2, nan=0.0)
    worst = {
        number: float(segment_chi2[[*contact.before, *contact.after]].max())
        for number, contact in enumerate(solution.graph.contacts)
        if contact.kind == "ball"
    }
    for number in sorted(worst, key=lambda number: -worst[number])[:MAX_REMOVALS]:
        contact = solution.graph.contacts[number]
        key = (*sorted(solution.graph.balls_at(contact)), round(contact.t, 2))
        if worst[number] < BENT_CHI2 or key in cache.required:
            continue
        trial = refine_graph(separate_balls(solution.graph, number), observations, table, TRIAL_ITERATIONS, solution)
        if total_cost(trial, prices) < total_cost(solution, prices):
            solution = refine_graph(trial.graph, observations, table, initial=trial)
        else:
            cache.required.add(key)
    return solution


def separate_balls(graph: ContactGraph, number: int) -> ContactGraph:
    """Replace a ball contact by separate velocity changes of each ball.

    Args:
        graph: The contact graph.
        number: The ball contact.

    Returns:
        The graph; the change of the first ball keeps the index, that of the other one is the last contact.
    """
    contact, segments, contacts = graph.contacts[number], list(graph.segments), list(graph.contacts)
    for slot, index in ((0, number), (1, len(contacts))):
        before, after = contact.before[slot], contact.after[slot]
        kind: ContactKind = "strike" if segments[before].static else "free"
        single = Contact(kind, contact.t, (before,), (after,), gain=contact.gain)
        segments[before], segments[after] = replace(segments[before], end=index), replace(segments[after], start=index)
        contacts[index : index + 1] = [single]
    return ContactGraph(tuple(segments), tuple(contacts)).mark_pushed_strikes()


def refine_differences(
    solution: JointSolution, one: ContactGraph, other: ContactGraph, observations: Observations, table: Table
) -> tuple[JointSolution, JointSolution] | None:
    """Refine the segments in which two graphs differ, by themselves.

    Args:
        solution: Solution with the coefficients.
        one: A graph.
        other: The same graph with changed contacts; it has the segments of the first one, then new ones.
        observations: K observations.

    Returns:
        The refined parts of both graphs; None where no sample belongs to these segments.
    """
    differing = {k for k in range(len(one.segments)) if not _is_same_segment(one, other, k)}
    rows = np.isin(assign_observations(one, observations), list(differing))
    if not rows.any():
        return None
    local = observations.select_rows(rows)
    new = differing | set(range(len(one.segments), len(other.segments)))
    return (
        refine_subgraph(solution, one, sorted(differing), local, table),
        refine_subgraph(solution, other, sorted(new), local, table),
    )


def _is_same_segment(one: ContactGraph, other: ContactGraph, k: int) -> bool:
    """Return whether a segment is the same in two graphs."""
    a, b = one.segments[k], other.segments[k]
    is_same_motion = a.static == b.static and np.array_equal(a.state, b.state)
    return is_same_motion and _describe_ends(one, k) == _describe_ends(other, k)


def _describe_ends(graph: ContactGraph, k: int) -> tuple[object, ...]:
    """Return the kinds and times of the contacts at the ends of a segment."""
    ends = (graph.segments[k].start, graph.segments[k].end)
    return tuple(None if c is None else (graph.contacts[c].kind, graph.contacts[c].t) for c in ends)
