"""Rival causes of a velocity change: contacts with other balls, and separate changes instead of a contact."""

from __future__ import annotations

from dataclasses import replace

from models.core.contact_graph import ContactGraph
from models.core.joint_solution import JointSolution, Observations
from models.core.scene import Table
from models.core.shot import ContactRivals, RivalContact
from models.estimation.structure_search.contact_partners import find_partners, join_by_ball_contact
from models.estimation.structure_search.contact_removal import refine_differences, separate_balls


def collect_hypotheses(solution: JointSolution, observations: Observations, table: Table) -> tuple[ContactRivals, ...]:
    """Collect what may have happened instead of every contact of the graph.

    Args:
        solution: The best explanation, with C contacts.
        observations: K observations.
        table: The table.

    Returns:
        (C,) rivals of each contact.
    """
    collected = []
    for number, contact in enumerate(solution.graph.contacts):
        if contact.kind in ("jump", "break"):
            collected.append(ContactRivals((), 0.0))
            continue
        apart = cost_of_separate_changes(solution, observations, number, table) if contact.kind == "ball" else 0.0
        rivals = find_rival_contacts(solution, observations, number, table)
        collected.append(ContactRivals(tuple(rivals), apart))
    return tuple(collected)


def find_rival_contacts(
    solution: JointSolution, observations: Observations, number: int, table: Table
) -> list[RivalContact]:
    """Find the other balls that may have caused a velocity change, the best first.

    Args:
        solution: The best explanation.
        observations: K observations.
        number: Contact whose rivals are wanted.
        table: The table.

    Returns:
        The rivals, each refined by itself.
    """
    contact = solution.graph.contacts[number]
    if contact.kind != "ball":
        return _find_rivals_of_change(solution, observations, number, table, solution.graph)
    partners = solution.graph.balls_at(contact)
    apart = replace(solution, graph=separate_balls(solution.graph, number))
    rivals = []
    for slot in (number, len(apart.graph.contacts) - 1):
        rivals += [
            one for one in _find_rivals_of_change(apart, observations, slot, table, solution.graph)
            if one.other not in partners
        ]  # fmt: skip
    return sorted(rivals, key=lambda one: one.cost)


def cost_of_separate_changes(solution: JointSolution, observations: Observations, number: int, table: Table) -> float:
    """Return the chi2 by which two separate velocity changes differ from a contact of two balls, at most 0.

    The law of the contact explains nothing where separate changes fit much better.
    """
    apart = separate_balls(solution.graph, number)
    return min(_evaluate_cost(solution, solution.graph, apart, observations, table), 0.0)


def _find_rivals_of_change(
    solution: JointSolution, observations: Observations, number: int, table: Table, best: ContactGraph
) -> list[RivalContact]:
    rivals = []
    for partner in find_partners(solution, observations, number, table):
        joined = join_by_ball_contact(solution, observations, number, partner, table)
        if joined is not None:
            ball = solution.graph.segments[solution.graph.contacts[number].before[0]].ball
            cost = _evaluate_cost(solution, best, joined, observations, table)
            rivals.append(RivalContact(ball, solution.graph.segments[partner.segment].ball, cost))
    return sorted(rivals, key=lambda one: one.cost)


def _evaluate_cost(
    solution: JointSolution, best: ContactGraph, other: ContactGraph, observations: Observations, table: Table
) -> float:
    """Return the chi2 of another graph minus that of the best one, on the segments that differ."""
    parts = refine_differences(solution, best, other, observations, table)
    return 0.0 if parts is None else parts[1].chi2 - parts[0].chi2
