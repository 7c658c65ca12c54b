"""Marks of contacts applied to a contact graph; the physics goes on from there and may contradict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations, layout_parameters
from models.core.corrections import HAND_ODDS, HAND_TIME_FRAMES
from models.core.fit_result import MarkOutcome, MarkOutcomeCode
from models.core.options import REQUIRED_GAIN
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.hand_marks.resolved_marks import (
    NO_BALL,
    ResolvedMark,
    describe_outcome,
)
from models.estimation.joint_fit.contact_cascades import (
    MIN_CONTACT_INTERVAL,
    evaluate_state,
    find_segment_at,
    find_unexplained_change,
    insert_cascade,
    predict_cascade,
)
from models.estimation.joint_fit.fit_solution import assign_observations
from models.estimation.segmentation.contact_classification import INWARD_NORMALS, cushion_distances
from models.estimation.structure_search.missed_cushions import guess_rebound
from models.estimation.structure_search.structure_trials import StructureSearch, separate_balls

# chi2 that stands for these odds: the physics contradicts a mark where it costs more.
HAND_CHI2 = 2 * float(np.log(HAND_ODDS))
# chi2: stands for the gain of a marked contact while the structure is searched, which does not question it.
HELD_GAIN = 1e5
# Ball radii between two surfaces beyond which they cannot have met.
REACH_RADII = 1.0
# Samples after a strike from which its velocity is guessed.
STRIKE_SAMPLES = 6
# Standard deviations by which the fitted time differs from the one that was set: one in 400 by chance.
CONTRADICTION_SIGMAS = 3.0


def apply_marks(solution: JointSolution, marks: Sequence[ResolvedMark], search: StructureSearch) -> JointSolution:
    """Apply marks to a contact graph and refine it, before its structure is searched.

    Args:
        solution: A refined solution.
        search: Observations, table and prices.

    Returns:
        The solution with marked contacts, which a search keeps, and without deleted ones.
    """
    for mark in marks:
        solution, _ = _apply_mark(solution, mark, search)
    return solution


def settle_marks(
    solution: JointSolution, marks: Sequence[ResolvedMark], search: StructureSearch, ids: tuple[str, ...]
) -> tuple[JointSolution, tuple[MarkOutcome, ...]]:
    """Apply marks to the contact graph after the last search, and compare them with the motion.

    Args:
        solution: A refined solution.
        search: Observations, table and prices.
        ids: Ids of the N balls.

    Returns:
        The solution, in which every marked contact has the gain that the motion gives it, and the outcomes.
    """
    outcomes = []
    for mark in marks:
        solution, outcome = _apply_mark(solution, mark, search)
        number = find_contact(solution.graph, mark, mark.t)
        if mark.mark.kind != "delete" and number is not None:
            without = search.refine(solution.graph.remove_contact(number).mark_pushed_strikes(), solution)
            gain = without.chi2 - solution.chi2
            graph = solution.graph.replace_contact(number, replace(solution.graph.contacts[number], gain=gain))
            solution = replace(solution, graph=graph)
            outcome = ("confirmed" if gain >= REQUIRED_GAIN else "no_change", gain)
        outcomes.append(describe_outcome(mark, ids, *outcome))
    return solution, tuple(outcomes)


def combine_marked_times(
    solution: JointSolution,
    times: Mapping[int, tuple[float, float]],
    marks: Sequence[ResolvedMark],
    outcomes: tuple[MarkOutcome, ...],
    observations: Observations,
) -> tuple[dict[int, tuple[float, float]], tuple[MarkOutcome, ...]]:
    """Combine the times of marked contacts with those that a person set.

    Args:
        solution: A solution with its covariance.
        times: Refined times and their standard deviations, s, by contact; others are those of the solution.
        outcomes: The outcome of each mark so far.
        observations: K observations.

    Returns:
        The times, and the outcomes; where the motion contradicts a time, it stays and the outcome says so.
    """
    variance = np.diag(solution.covariance)[layout_parameters(solution.graph).contact :]
    combined, final = dict(times), list(outcomes)
    for k, mark in enumerate(marks):
        number = None if mark.mark.kind == "delete" else find_contact(solution.graph, mark, mark.t)
        if number is None:
            continue
        own = float(np.sqrt(max(variance[number], 0.0)))
        t, own = combined.get(number, (solution.graph.contacts[number].t, own))
        sigma = HAND_TIME_FRAMES * observations.frame_interval
        total = float(np.hypot(own, sigma))
        if outcomes[k].code != "no_change" and abs(t - mark.t) > CONTRADICTION_SIGMAS * total:
            final[k] = replace(final[k], code="other_time", value=t - mark.t)
        else:
            combined[number] = t + (own / total) ** 2 * (mark.t - t), own * sigma / total
    return combined, tuple(final)


def contradict_unheld_marks(
    solution: JointSolution, marks: Sequence[ResolvedMark], outcomes: tuple[MarkOutcome, ...]
) -> tuple[MarkOutcome, ...]:
    """Correct the outcomes of marks whose contact is at another time in the end.

    Args:
        solution: The final solution.
        outcomes: The outcome of each mark so far.

    Returns:
        The outcomes; a confirmed mark without a contact within its tolerance is at another time.
    """
    final = list(outcomes)
    for k, mark in enumerate(marks):
        is_settled = outcomes[k].code != "confirmed" or mark.mark.kind == "delete"
        if is_settled or find_contact(solution.graph, mark, mark.t) is not None:
            continue
        number = find_contact(solution.graph, replace(mark, tolerance=np.inf), mark.t)
        if number is not None:
            final[k] = replace(outcomes[k], code="other_time", value=solution.graph.contacts[number].t - mark.t)
    return tuple(final)


def find_contact(graph: ContactGraph, mark: ResolvedMark, t: float) -> int | None:
    """Find the contact of a graph that a mark means.

    Args:
        graph: The contact graph.
        t: s.

    Returns:
        Number of the contact nearest to t within the tolerance; None for none.
    """
    near = [
        (abs(contact.t - t), number)
        for number, contact in enumerate(graph.contacts)
        if contact.kind == mark.mark.cause
        and contact.cushion == mark.mark.cushion
        and graph.balls_at(contact) == mark.balls
        and abs(contact.t - t) <= mark.tolerance
    ]
    return min(near)[1] if near else None


Outcome = tuple[MarkOutcomeCode, float]


def _apply_mark(solution: JointSolution, mark: ResolvedMark, search: StructureSearch) -> tuple[JointSolution, Outcome]:
    """Apply one mark; return also its outcome as far as it is known."""
    if mark.mark.kind == "delete":
        return _delete_contact(solution, mark, search)
    number = find_contact(solution.graph, mark, mark.t)
    if mark.mark.kind == "move" and number is None:
        number = find_contact(solution.graph, mark, mark.earlier_t)
    if number is not None:
        return _hold_contact(solution, number, mark, search), ("confirmed", np.nan)
    return _insert_contact(solution, mark, search)


def _hold_contact(solution: JointSolution, number: int, mark: ResolvedMark, search: StructureSearch) -> JointSolution:
    """Keep a contact through the search; a moved one starts from its new time."""
    contact = solution.graph.contacts[number]
    fixed = replace(contact, gain=HELD_GAIN)
    if mark.mark.kind == "move" and abs(contact.t - mark.t) > mark.tolerance / 2:
        trial = solution.graph.replace_contact(number, replace(fixed, t=mark.t))
        spans = [(trial.start_time(k), trial.end_time(k)) for k in (*fixed.before, *fixed.after)]
        if all(end > start + MIN_CONTACT_INTERVAL for start, end in spans):
            moved = search.refine(trial, solution)
            if moved.chi2 < solution.chi2 + HAND_CHI2:
                return moved
    return replace(solution, graph=solution.graph.replace_contact(number, fixed))


def _delete_contact(
    solution: JointSolution, mark: ResolvedMark, search: StructureSearch
) -> tuple[JointSolution, Outcome]:
    """Remove a contact; where the velocity changes nevertheless, the change stays without a cause."""
    number = find_contact(solution.graph, mark, mark.t)
    if number is None:
        return solution, ("confirmed", 0.0)
    graph = solution.graph
    trials = [search.refine(graph.remove_contact(number).mark_pushed_strikes(), solution)]
    if graph.contacts[number].kind == "ball":
        trials.append(search.refine(separate_balls(graph, number), solution))
    else:
        free = replace(graph.contacts[number], kind="free", cushion="", gain=0.0)
        trials.append(search.refine(graph.replace_contact(number, free), solution))
    best = min(trials, key=search.cost)
    if best is trials[0]:
        return best, ("confirmed", best.chi2 - solution.chi2)
    return best, ("change_remains", trials[0].chi2 - solution.chi2)


def _insert_contact(
    solution: JointSolution, mark: ResolvedMark, search: StructureSearch
) -> tuple[JointSolution, Outcome]:
    """Insert a missed contact; no change if its bodies are too far apart or the physics contradicts it."""
    gap = _measure_gap(solution, mark, search.table)
    if gap > REACH_RADII * search.table.ball_radius:
        return solution, ("too_far", gap)
    graph = (
        _insert_ball_contact(solution, mark, search) if mark.b != NO_BALL else _insert_single(solution, mark, search)
    )
    if graph is None:
        return solution, ("no_change", np.nan)
    trial = search.refine(graph.mark_pushed_strikes(), solution)
    if not trial.chi2 < solution.chi2 + HAND_CHI2:
        return solution, ("no_change", solution.chi2 - trial.chi2)
    number = find_contact(trial.graph, mark, mark.t)
    if number is None:  # the motion puts it at another time
        return solution, ("no_change", solution.chi2 - trial.chi2)
    fixed = replace(trial.graph.contacts[number], gain=HELD_GAIN)
    return replace(trial, graph=trial.graph.replace_contact(number, fixed)), ("confirmed", np.nan)


def _measure_gap(solution: JointSolution, mark: ResolvedMark, table: Table) -> float:
    """Return the distance of the surfaces that a mark lets meet, m; 0 for a strike."""
    place = _evaluate_ball(solution, mark.a, mark.t)[:2]
    if mark.b != NO_BALL:
        return float(np.hypot(*(_evaluate_ball(solution, mark.b, mark.t)[:2] - place))) - 2 * table.ball_radius
    if mark.mark.cushion:
        return float(cushion_distances(place, table)[CUSHIONS.index(mark.mark.cushion)]) - table.ball_radius
    return 0.0


def _evaluate_ball(solution: JointSolution, ball: int, t: float) -> FloatArray:
    """Return the state (6,) of a ball at t, s."""
    graph = solution.graph
    return evaluate_state(graph, solution.friction, find_segment_at(graph, ball, t), t)


def _insert_ball_contact(solution: JointSolution, mark: ResolvedMark, search: StructureSearch) -> ContactGraph | None:
    """Insert a contact of two balls; a velocity change without a cause nearby becomes part of it."""
    graph, interval = solution.graph, search.interval
    radius = search.table.ball_radius * solution.diameter_factor
    owner = assign_observations(graph, search.observations)
    changes = (find_unexplained_change(graph, ball, mark.t, mark.tolerance) for ball in (mark.a, mark.b))
    times = [graph.contacts[number].t for number in changes if number is not None]
    t = float(np.mean(times)) if times else mark.t
    contacts = predict_cascade(graph, solution.friction, mark.a, mark.b, t, interval, radius)[:1]
    return insert_cascade(graph, search.observations, owner, contacts, mark.tolerance)


def _insert_single(solution: JointSolution, mark: ResolvedMark, search: StructureSearch) -> ContactGraph | None:
    """Insert a contact with a cushion, or a strike; a velocity change without a cause nearby becomes it."""
    graph = solution.graph
    change = find_unexplained_change(graph, mark.a, mark.t, mark.tolerance)
    if change is not None:
        return graph.replace_contact(
            change, replace(graph.contacts[change], kind=mark.mark.cause, cushion=mark.mark.cushion)
        )
    k = find_segment_at(graph, mark.a, mark.t)
    if not graph.start_time(k) + MIN_CONTACT_INTERVAL < mark.t < graph.end_time(k) - MIN_CONTACT_INTERVAL:
        return None
    before, data = _evaluate_ball(solution, mark.a, mark.t), search.observations
    if mark.mark.cushion:
        state = guess_rebound(before, INWARD_NORMALS[CUSHIONS.index(mark.mark.cushion)])
    else:
        state = np.concatenate([before, np.zeros(2)])
        is_after = (data.ball == mark.a) & (data.t >= mark.t) & (data.t < graph.end_time(k))
        rows = np.flatnonzero(is_after)[:STRIKE_SAMPLES]
        if len(rows) > 1:
            state[2:4] = np.polynomial.polynomial.polyfit(data.t[rows], data.xy[rows], 1)[1]
            state[4:6] = state[2:4]
    contact = Contact(mark.mark.cause, mark.t, (k,), (), mark.mark.cushion)
    return graph.insert_contact(contact, (state,))
