"""Hand-made contact graphs of filmed shots, refined: the start of tests of the structure search."""

from __future__ import annotations

import numpy as np
from support.filmed_shots import Filmed

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Segment
from models.estimation.joint_fit.fit_solution import collect_observations
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.structure_trials import StructureSearch

PRICES = (20.0, 150.0)
"""Of contacts with a cause and without."""


def resting(ball: int, place: tuple[float, float], end: int | None) -> Segment:
    """From the start of the clip until contact `end`."""
    return Segment(ball, True, None, end, 0.0, np.array([*place, *np.zeros(6)]))


def moving(
    ball: int, start: int, end: int | None, t: float, place: tuple[float, float], v: tuple[float, float]
) -> Segment:
    """From contact `start` at t (s) on; it rolls."""
    return Segment(ball, False, start, end, t, np.array([*place, *v, 0.1 * v[0], 0.1 * v[1], 0.0, 0.0]))


def start_search(
    shot: Filmed, segments: list[Segment], contacts: list[Contact]
) -> tuple[JointSolution, StructureSearch]:
    """The best solution of a contact graph, and a search that starts from it."""
    search = StructureSearch(collect_observations(shot.tracks), shot.scene.table, PRICES)
    graph = ContactGraph(tuple(segments), tuple(contacts)).mark_pushed_strikes()
    return refine_graph(graph, search.observations, search.table), search


def list_contact_names(solution: JointSolution) -> list[tuple[str, ...]]:
    """Kinds of the contacts of a solution with the balls that take part, in the order of time."""
    graph = solution.graph
    return [
        (one.kind, *sorted(map(str, graph.balls_at(one))), *([one.cushion] if one.cushion else []))
        for one in sorted(graph.contacts, key=lambda one: one.t)
    ]
