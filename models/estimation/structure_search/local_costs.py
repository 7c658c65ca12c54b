"""Costs of two graphs on the segments in which they differ."""

from __future__ import annotations

import numpy as np

from models.core.contact_graph import ContactGraph
from models.core.joint_solution import JointSolution, Observations
from models.core.scene import Table
from models.estimation.joint_fit.fit_solution import assign_observations
from models.estimation.structure_search.ball_encounters import refine_subgraph


def refine_differences(
    solution: JointSolution, one: ContactGraph, other: ContactGraph, observations: Observations, table: Table
) -> tuple[JointSolution, JointSolution] | None:
    """Refine the segments in which two graphs differ, by themselves.

    Args:
        solution: Solution with the coefficients.
        one: A graph.
        other: The same graph with changed contacts; it has the segments of the first one, then new ones.
        observations: K observations.
        table: The table.

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
