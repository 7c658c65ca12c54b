"""Causes of velocity changes that nothing explains: another ball, wherever one could have been there."""

from __future__ import annotations

from models.core.scene import Table
from models.estimation.joint_fit.fit_solution import JointSolution, Observations
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.segmentation.contact_graph import ContactGraph
from models.estimation.structure_search.ball_encounters import SearchCache, total_cost
from models.estimation.structure_search.contact_partners import (
    CAUSELESS_KINDS,
    find_partners,
    join_by_ball_contact,
)
from models.estimation.structure_search.missed_cushions import classify_cushion_turns


def explain_causeless_changes(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float], cache: SearchCache
) -> JointSolution:
    """Explain velocity changes without a cause by contacts with other balls where that lowers the total cost.

    Args:
        solution: A refined solution.
        observations: K observations.
        table: The table.
        prices: chi2 that contacts with a cause and without cost.
        cache: Keeps the changes that are not to be tried again.

    Returns:
        The refined solution.
    """
    number = 0
    while number < len(solution.graph.contacts):
        contact, segments = solution.graph.contacts[number], solution.graph.segments
        key = ("partners", segments[contact.before[0]].ball, round(contact.t, 3), round(solution.chi2, 1))
        if contact.kind not in CAUSELESS_KINDS or key in cache.required:
            number += 1
            continue
        cost = total_cost(solution, prices)
        graphs = [
            join_by_ball_contact(solution, observations, number, partner, table)
            for partner in find_partners(solution, observations, number, table)
        ]
        trials = [_refine_trial(g, solution, observations, table) for g in graphs if g is not None]
        best = min(trials, key=lambda one: total_cost(one, prices), default=solution)
        if total_cost(best, prices) < cost:
            solution, number = best, 0
        else:
            cache.required.add(key)
            number += 1
    return solution


def _refine_trial(
    graph: ContactGraph, initial: JointSolution, observations: Observations, table: Table
) -> JointSolution:
    """Refine a graph; where a ball then turns at a cushion, that is the cause."""
    trial = refine_graph(graph, observations, table, initial=initial)
    classified = classify_cushion_turns(trial, table)
    return trial if classified is trial.graph else refine_graph(classified, observations, table, initial=trial)
