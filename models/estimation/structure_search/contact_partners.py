"""Partners of a velocity change: the other balls that may have caused it.

A ball at rest starts only when something touches it. Where a ball starts or turns and no cause was found, another ball
may have been there between two frames, or while it was not detected. Every ball whose path, before or after a turn of
its own, comes near enough in that time is a candidate; the refit of the contact decides.
Velocity changes without a cause take the partner that explains them best.
Rivals of a contact are other partners, and separate changes instead of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.contact_graph import CAUSELESS_KINDS, Contact, ContactGraph, JointSolution, Observations
from models.core.scene import Table
from models.core.shot import ContactRivals, RivalContact
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import assign_observations, end_state
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.ball_encounters import LOCAL_ITERATIONS, SearchCache, total_cost
from models.estimation.structure_search.contact_removal import refine_differences, separate_balls
from models.estimation.structure_search.missed_cushions import classify_cushion_turns, insert_crossed_cushions
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# Ball radii: two balls so far from touching may have met where one of them changes its velocity.
TOUCH_TOLERANCE = 0.5
# Frame intervals: error of the time at which a path turns, which moves the turn along the path.
TIME_TOLERANCE = 0.5
# Most candidates of one velocity change.
MAX_PARTNERS = 3


@dataclass(frozen=True, slots=True)
class Partner:
    """Another ball that may have touched: its moving segment, and when it came nearest to touching."""

    segment: int
    t: float
    mismatch: float
    """m: distance of the centres minus two radii, absolute."""


def find_partners(solution: JointSolution, observations: Observations, number: int, table: Table) -> list[Partner]:
    """Find the balls that may have touched the ball of a contact, the nearest first.

    Args:
        solution: A refined solution.
        observations: K observations.
        number: Contact of one ball, or of which the first ball is meant.

    Returns:
        At most `MAX_PARTNERS` candidates, one per ball.
    """
    graph, contact = solution.graph, solution.graph.contacts[number]
    ball = graph.segments[contact.before[0]].ball
    early, late, interval = find_unobserved_span(observations, ball, contact.t)
    reach = 2 * table.ball_radius * solution.diameter_factor
    best: dict[int, Partner] = {}
    for k, segment in enumerate(graph.segments):
        if segment.static or segment.ball == ball:
            continue
        # a turn of the other ball is this contact, so that its path before and after is followed a little further
        begin = max(graph.start_time(k) - TIME_TOLERANCE * interval, early)
        end = min(graph.end_time(k) + TIME_TOLERANCE * interval, late)
        if end - begin < MIN_CONTACT_INTERVAL:
            continue
        t = np.linspace(begin, end, 41)
        states = np.repeat(segment.state[None], len(t), axis=0)
        path = evaluate_kinematics(states, np.maximum(t - graph.start_time(k), 0.0), solution.friction)
        path[:, :2] += np.minimum(t - graph.start_time(k), 0.0)[:, None] * segment.state[2:4]
        mismatch = np.abs(np.linalg.norm(path[:, :2] - _place_of(solution, contact, t), axis=1) - reach)
        least = int(np.argmin(mismatch))
        speed = float(np.hypot(*path[least, 2:4]))
        tolerance = TOUCH_TOLERANCE * table.ball_radius + TIME_TOLERANCE * interval * speed
        candidate = Partner(k, float(t[least]), float(mismatch[least]))
        if candidate.mismatch < tolerance and speed > MIN_CONTACT_SPEED:
            nearest = best.get(segment.ball)
            if nearest is None or candidate.mismatch < nearest.mismatch:
                best[segment.ball] = candidate
    return sorted(best.values(), key=lambda one: one.mismatch)[:MAX_PARTNERS]


def find_unobserved_span(observations: Observations, ball: int, t: float) -> tuple[float, float, float]:
    """Find the samples of a ball before and after a time, widened by half of a frame, and the frame interval, s."""
    times = observations.t[observations.ball == ball]
    interval = observations.frame_interval
    row = int(np.searchsorted(times, t))
    early = float(times[row - 1]) if row else t - interval
    late = float(times[row]) if row < len(times) else t + interval
    return early - 0.5 * interval, late + 0.5 * interval, interval


def join_by_ball_contact(
    solution: JointSolution, observations: Observations, number: int, partner: Partner, table: Table
) -> ContactGraph | None:
    """Explain a velocity change by a contact with another ball.

    An unexplained change of the other ball nearby becomes part of the contact; else its path is cut there. The ball
    that is hit leaves along the line of centres, which places the other one.

    Args:
        solution: A refined solution.
        observations: K observations.
        number: Contact of one ball.
        partner: The other ball.

    Returns:
        The new graph; None where it is impossible.
    """
    graph, contact = solution.graph, solution.graph.contacts[number]
    one, other = contact.before[0], graph.segments[partner.segment].ball
    _, _, interval = find_unobserved_span(observations, other, partner.t)
    turn = _find_causeless_turn(graph, partner, number, interval)
    if turn is None and not (
        graph.start_time(partner.segment) + MIN_CONTACT_INTERVAL
        < partner.t
        < graph.end_time(partner.segment) - MIN_CONTACT_INTERVAL
    ):
        return None
    before = partner.segment if turn is None else graph.contacts[turn].before[0]
    t = partner.t
    if not graph.start_time(one) + MIN_CONTACT_INTERVAL < t < graph.end_time(contact.after[0]) - MIN_CONTACT_INTERVAL:
        return None
    if graph.segments[one].static and graph.segments[before].static:
        return None
    place = _place_of(solution, contact, np.array([t]))[0]
    change = graph.segments[contact.after[0]].state[2:4] - end_state(solution, one)[2:4]
    line = change / max(float(np.hypot(*change)), 1e-9)
    meeting = place - 2 * table.ball_radius * solution.diameter_factor * line
    later = np.flatnonzero((observations.ball == other) & (observations.t > t + MIN_CONTACT_INTERVAL))
    after = end_state(solution, before)
    after[2:6] -= np.tile(float(after[2:4] @ line) * line, 2)
    after[:2] = meeting
    if len(later):
        velocity = (observations.xy[later[0]] - meeting) / (observations.t[later[0]] - t)
        after[2:4] = velocity
    if turn is None:
        graph = graph.insert_contact(Contact("free", t, (before,), ()), (np.concatenate([after, np.zeros(2)]),))
        turn = len(graph.contacts) - 1
    elif not graph.segments[graph.contacts[turn].after[0]].static:
        k = graph.contacts[turn].after[0]
        state = np.concatenate([after, graph.segments[k].state[6:]])
        graph = ContactGraph(
            tuple(replace(s, state=state) if q == k else s for q, s in enumerate(graph.segments)), graph.contacts
        )
    second = graph.contacts[turn]
    joined = Contact(
        "ball", t, (*contact.before, *second.before), (*contact.after, *second.after), gain=contact.gain + second.gain
    )
    merged = graph.merge_contacts(number, turn, joined)
    is_ordered = all(merged.end_time(k) > merged.start_time(k) + 1e-4 for k in range(len(merged.segments)))
    return merged.mark_pushed_strikes() if is_ordered else None


def _find_causeless_turn(graph: ContactGraph, partner: Partner, number: int, interval: float) -> int | None:
    """Find the unexplained velocity change of the other ball that is nearest to the time of the contact."""
    segment = graph.segments[partner.segment]
    turns = [
        c
        for c in (segment.start, segment.end)
        if c is not None and c != number and graph.contacts[c].kind in CAUSELESS_KINDS
        and abs(graph.contacts[c].t - partner.t) < interval
    ]  # fmt: skip
    return min(turns, key=lambda c: abs(graph.contacts[c].t - partner.t), default=None)


def _place_of(solution: JointSolution, contact: Contact, t: FloatArray) -> FloatArray:
    """Return the places (M, 2) of the first ball of a contact at times t (M,) s on its path before the contact."""
    segment = solution.graph.segments[contact.before[0]]
    if segment.static:
        return np.repeat(segment.state[None, :2], len(t), axis=0)
    tau = np.maximum(t - solution.graph.start_time(contact.before[0]), 0.0)
    return evaluate_kinematics(np.repeat(segment.state[None], len(t), axis=0), tau, solution.friction)[:, :2]


# Prices of a causeless change by which a contact may cost more locally before all segments are refined: a turn nearby
# that is wrong without the contact is only mended then.
LOCAL_SLACK = 3.0

# Refinements of the whole clip in vain after which a round stops: racks have many turns that no contact explains.
MAX_FAILED_TRIALS = 4
# Frame intervals by which a turn that no law constrains may be misplaced.
TURN_TIME_ERROR = 0.1


def explain_causeless_changes(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float], cache: SearchCache
) -> JointSolution:
    """Explain velocity changes without a cause by contacts with other balls where that lowers the total cost.

    Args:
        solution: A refined solution.
        observations: K observations.
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


def collect_hypotheses(solution: JointSolution, observations: Observations, table: Table) -> tuple[ContactRivals, ...]:
    """Collect what may have happened instead of every contact of the graph.

    Args:
        solution: The best explanation, with C contacts.
        observations: K observations.

    Returns:
        (C,) rivals of each contact.
    """
    collected = []
    for number, contact in enumerate(solution.graph.contacts):
        if contact.kind in ("jump", "break"):
            collected.append(ContactRivals((), 0.0))
            continue
        apart = _cost_of_separate_changes(solution, observations, number, table) if contact.kind == "ball" else 0.0
        rivals = _find_rival_contacts(solution, observations, number, table)
        collected.append(ContactRivals(tuple(rivals), apart))
    return tuple(collected)


def _find_rival_contacts(
    solution: JointSolution, observations: Observations, number: int, table: Table
) -> list[RivalContact]:
    """Find the other balls that may have caused a velocity change, the best first.

    Args:
        solution: The best explanation.
        observations: K observations.
        number: Contact whose rivals are wanted.

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


def _cost_of_separate_changes(solution: JointSolution, observations: Observations, number: int, table: Table) -> float:
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
