"""Completion of contact chains: contacts that follow from one within a few frames are inserted together.

A ball that runs into another one which lies against a third seems to stop while the third starts; the one between
hardly moves. With the first contact alone, the following motion has no cause, or the paths are bent.
"""

from __future__ import annotations

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.scene import Table
from models.estimation.joint_fit.contact_cascades import CascadeContact, insert_cascade, predict_cascade
from models.estimation.joint_fit.fit_solution import assign_observations
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.joint_fit.trust_level import evaluate_segment_chi2
from models.estimation.structure_search.ball_encounters import TIME_TOLERANCE, SearchCache, total_cost

# Frame intervals after a contact in which it may set balls in motion.
HORIZONS = (1.0, 2.5)
# chi2 per degree of freedom of a path that one more contact may improve.
BENT_CHI2 = 1.5
# Trials in one round.
MAX_TRIALS = 6
# Iterations that show whether a graph deserves more of them.
TRIAL_ITERATIONS = 10


def complete_chains(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float], cache: SearchCache
) -> JointSolution:  # fmt: skip
    """Complete the chains of ball contacts where the total cost of the clip falls.

    `prices` are those of contacts with a cause and without; `cache` keeps what was rejected.
    """
    trial_count = 0
    for contact in _find_suspicious_contacts(solution, observations):
        for horizon in HORIZONS:
            number = next((k for k, one in enumerate(solution.graph.contacts) if one == contact), None)
            if number is None or trial_count >= MAX_TRIALS:
                break
            key = (horizon, *sorted(solution.graph.balls_at(contact)), round(contact.t, 2))
            extended = None if key in cache.required else _insert_chain(solution, observations, table, number, horizon)
            if extended is None:
                continue
            trial_count += 1
            trial = refine_graph(extended, observations, table, TRIAL_ITERATIONS, solution)
            if total_cost(trial, prices) < total_cost(solution, prices):
                solution = refine_graph(trial.graph, observations, table, initial=trial)
            else:
                cache.required.add(key)
    return solution


def _find_suspicious_contacts(solution: JointSolution, observations: Observations) -> list[Contact]:
    """Find ball contacts beside an unexplained start, or with bent paths, the worst first."""
    graph, reach = solution.graph, TIME_TOLERANCE * observations.frame_interval
    chi2 = np.nan_to_num(evaluate_segment_chi2(solution, observations)[0], nan=0.0)
    unexplained_times = np.array([c.t for c in graph.contacts if c.kind == "free" or c.pushed])
    suspicious = []
    for contact in graph.contacts:
        if contact.kind == "ball":
            worst_chi2 = float(chi2[[*contact.before, *contact.after]].max())
            is_beside_unexplained = bool(len(unexplained_times) and np.abs(unexplained_times - contact.t).min() < reach)
            if is_beside_unexplained or worst_chi2 > BENT_CHI2:
                suspicious.append((-worst_chi2 - 10.0 * is_beside_unexplained, contact.t, contact))
    return [contact for _, _, contact in sorted(suspicious, key=lambda one: one[:2])]


def _insert_chain(
    solution: JointSolution, observations: Observations, table: Table, number: int, horizon: float
) -> ContactGraph | None:
    """Insert what follows from a contact; None if the graph already contains it."""
    graph, interval = solution.graph, observations.frame_interval
    contact = graph.contacts[number]
    a, b = (graph.segments[k].ball for k in contact.before)
    reduced = graph.remove_contact(number)
    radius = table.ball_radius * solution.diameter_factor
    contacts = predict_cascade(reduced, solution.friction, a, b, contact.t, horizon * interval, radius)
    known_contacts = [(c.t, graph.balls_at(c)) for c in graph.contacts if c.kind == "ball"]
    if all(_is_in_graph(item, known_contacts, 2 * horizon * interval) for item in contacts[1:]):
        return None
    extended = insert_cascade(
        reduced, observations, assign_observations(reduced, observations), contacts, TIME_TOLERANCE * interval
    )
    return None if extended is None else extended.mark_pushed_strikes()


def _is_in_graph(contact: CascadeContact, known_contacts: list[tuple[float, set[int]]], time_tolerance: float) -> bool:
    """Return whether a contact of the same balls is in the graph at about that time."""
    return any(balls == {contact.a, contact.b} and abs(t - contact.t) < time_tolerance for t, balls in known_contacts)
