"""Causes of velocity changes that nothing explains: another ball, wherever one could have been there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.contact_graph import CAUSELESS_KINDS, ContactGraph
from models.core.joint_solution import JointSolution, Observations
from models.core.scene import Table
from models.estimation.joint_fit.fit_solution import assign_observations
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.ball_encounters import LOCAL_ITERATIONS, SearchCache, total_cost
from models.estimation.structure_search.contact_partners import find_partners, join_by_ball_contact
from models.estimation.structure_search.local_costs import refine_differences
from models.estimation.structure_search.missed_cushions import classify_cushion_turns, insert_crossed_cushions

LOCAL_SLACK = 3.0
"""Prices of a causeless change by which a contact may cost more locally before all segments are refined: a turn nearby
that is wrong without the contact is only mended then.
"""

MAX_FAILED_TRIALS = 4
"""Refinements of the whole clip in vain after which a round stops: racks have many turns that no contact explains."""
TURN_TIME_ERROR = 0.1
"""Frame intervals by which a turn that no law constrains may be misplaced."""


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
    number, failed = 0, 0
    while number < len(solution.graph.contacts) and failed < MAX_FAILED_TRIALS:
        contact, graph = solution.graph.contacts[number], solution.graph
        key = ("causeless", *graph.cache_key((*contact.before, *contact.after)))
        if contact.kind not in CAUSELESS_KINDS or key in cache.required:
            number += 1
            continue
        cache.required.add(key)
        cost = total_cost(solution, prices)
        trial = _join_best_partner(solution, observations, number, table, prices)
        is_turn = contact.kind == "free" and not graph.segments[contact.before[0]].static
        if is_turn and (trial is None or total_cost(trial, prices) >= cost):
            trial = _continue_to_cushion(solution, observations, table, number, prices)
        is_better = trial is not None and total_cost(trial, prices) < cost
        failed += trial is not None and not is_better
        solution, number = (trial, 0) if trial is not None and is_better else (solution, number + 1)
    return solution


def _join_best_partner(
    solution: JointSolution, observations: Observations, number: int, table: Table, prices: tuple[float, float]
) -> JointSolution | None:
    """Join a change with the ball whose contact costs least locally; None where every one costs much more."""
    best, least = None, LOCAL_SLACK * prices[1]
    for partner in find_partners(solution, observations, number, table):
        joined = join_by_ball_contact(solution, observations, number, partner, table)
        parts = joined and refine_differences(solution, solution.graph, joined, observations, table)
        if parts:
            before, after = (total_cost(part, prices) for part in parts)
            if after - before < least:
                best, least = joined, after - before
    return None if best is None else _refine_trial(best, solution, observations, table)


def _refine_trial(
    graph: ContactGraph, initial: JointSolution, observations: Observations, table: Table
) -> JointSolution:
    """Refine a graph; where a ball then turns at a cushion, that is the cause."""
    trial = refine_graph(graph, observations, table, initial=initial)
    classified = classify_cushion_turns(trial, table, TURN_TIME_ERROR * observations.frame_interval)
    return trial if classified is trial.graph else refine_graph(classified, observations, table, initial=trial)


def _continue_to_cushion(
    solution: JointSolution, observations: Observations, table: Table, number: int, prices: tuple[float, float]
) -> JointSolution | None:
    """Remove a velocity change, and let the ball turn at the cushion that its path then meets.

    None where the path meets none and bends too much to be that of one motion.
    """
    contact = solution.graph.contacts[number]
    excerpt, chosen = solution.graph.extract_contact(number)
    rows = np.isin(assign_observations(solution.graph, observations), chosen)
    local = observations.select_rows(rows)
    single = refine_graph(excerpt.remove_contact(0), local, table, iterations=LOCAL_ITERATIONS, initial=solution)
    without = solution.graph.remove_contact(number)
    k = contact.before[0] - int(contact.after[0] < contact.before[0])
    segments = list(without.segments)
    segments[k] = replace(segments[k], static=False, state=single.graph.segments[0].state)
    joined = replace(solution, graph=ContactGraph(tuple(segments), without.contacts))
    extended = insert_crossed_cushions(joined, joined.graph, observations, table)
    if extended is joined.graph and contact.gain > LOCAL_SLACK * prices[1]:
        return None
    return refine_graph(extended, observations, table, initial=joined)
