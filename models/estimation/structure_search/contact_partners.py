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
from models.core.shot import ContactRivals, RivalContact
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import end_state, evaluate_path
from models.estimation.structure_search.missed_cushions import classify_cushion_turns, insert_crossed_cushions
from models.estimation.structure_search.structure_trials import (
    LOCAL_ITERATIONS,
    StructureSearch,
    join_changes,
    separate_balls,
)

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


def find_partners(solution: JointSolution, search: StructureSearch, number: int) -> list[Partner]:
    """Find the balls that may have touched the ball of a contact, the nearest first.

    Args:
        solution: A refined solution.
        search: Observations and table.
        number: Contact of one ball, or of which the first ball is meant.

    Returns:
        At most `MAX_PARTNERS` candidates, one per ball.
    """
    graph, contact = solution.graph, solution.graph.contacts[number]
    ball, interval, radius = graph.segments[contact.before[0]].ball, search.interval, search.table.ball_radius
    early, late = _find_unobserved_span(search.observations, ball, contact.t, interval)
    reach = 2 * radius * solution.diameter_factor
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
        path = evaluate_path(graph, solution.friction, k, t)
        path[:, :2] += np.minimum(t - graph.start_time(k), 0.0)[:, None] * segment.state[2:4]
        place = evaluate_path(graph, solution.friction, contact.before[0], t)[:, :2]
        mismatch = np.abs(np.linalg.norm(path[:, :2] - place, axis=1) - reach)
        least = int(np.argmin(mismatch))
        speed = float(np.hypot(*path[least, 2:4]))
        tolerance = TOUCH_TOLERANCE * radius + TIME_TOLERANCE * interval * speed
        candidate = Partner(k, float(t[least]), float(mismatch[least]))
        if candidate.mismatch < tolerance and speed > MIN_CONTACT_SPEED:
            best[segment.ball] = min(best.get(segment.ball, candidate), candidate, key=lambda one: one.mismatch)
    return sorted(best.values(), key=lambda one: one.mismatch)[:MAX_PARTNERS]


def _find_unobserved_span(observations: Observations, ball: int, t: float, interval: float) -> tuple[float, float]:
    """Find the samples of a ball before and after a time, s, widened by half of a frame interval."""
    times = observations.t[observations.ball == ball]
    row = int(np.searchsorted(times, t))
    early = float(times[row - 1]) if row else t - interval
    late = float(times[row]) if row < len(times) else t + interval
    return early - 0.5 * interval, late + 0.5 * interval


def join_by_ball_contact(
    solution: JointSolution, search: StructureSearch, number: int, partner: Partner
) -> ContactGraph | None:
    """Explain a velocity change by a contact with another ball.

    An unexplained change of the other ball nearby becomes part of the contact; else its path is cut there. The ball
    that is hit leaves along the line of centres, which places the other one.

    Args:
        solution: A refined solution.
        search: Observations and table.
        number: Contact of one ball.
        partner: The other ball.

    Returns:
        The new graph; None where it is impossible.
    """
    graph, contact = solution.graph, solution.graph.contacts[number]
    one, other = contact.before[0], graph.segments[partner.segment].ball
    t, observations = partner.t, search.observations
    turn = _find_causeless_turn(graph, partner, number, search.interval)
    if turn is None and not _lasts_around(graph, partner.segment, partner.segment, t):
        return None
    before = partner.segment if turn is None else graph.contacts[turn].before[0]
    is_at_rest = graph.segments[one].static and graph.segments[before].static
    if is_at_rest or not _lasts_around(graph, one, contact.after[0], t):
        return None
    place = evaluate_path(graph, solution.friction, one, np.array([t]))[0, :2]
    change = graph.segments[contact.after[0]].state[2:4] - end_state(solution, one)[2:4]
    line = change / max(float(np.hypot(*change)), 1e-9)
    meeting = place - 2 * search.table.ball_radius * solution.diameter_factor * line
    later = np.flatnonzero((observations.ball == other) & (observations.t > t + MIN_CONTACT_INTERVAL))
    after = end_state(solution, before)
    after[2:6] -= np.tile(float(after[2:4] @ line) * line, 2)
    after[:2] = meeting
    if len(later):
        after[2:4] = (observations.xy[later[0]] - meeting) / (observations.t[later[0]] - t)
    if turn is None:
        graph = graph.insert_contact(Contact("free", t, (before,), ()), (np.concatenate([after, np.zeros(2)]),))
        turn = len(graph.contacts) - 1
    elif not graph.segments[graph.contacts[turn].after[0]].static:
        k = graph.contacts[turn].after[0]
        state = np.concatenate([after, graph.segments[k].state[6:]])
        graph = graph.replace_segment(k, replace(graph.segments[k], state=state))
    merged = join_changes(graph, number, turn, t, keep=number)
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


def _lasts_around(graph: ContactGraph, first: int, last: int, t: float) -> bool:
    """Return whether a time, s, lies between the start of a segment and the end of another one."""
    return graph.start_time(first) + MIN_CONTACT_INTERVAL < t < graph.end_time(last) - MIN_CONTACT_INTERVAL


# Prices of a causeless change by which a contact may cost more locally before all segments are refined: a turn nearby
# that is wrong without the contact is only mended then.
LOCAL_SLACK = 3.0

# Refinements of the whole clip in vain after which a round stops: racks have many turns that no contact explains.
MAX_FAILED_TRIALS = 4
# Frame intervals by which a turn that no law constrains may be misplaced.
TURN_TIME_ERROR = 0.1


def explain_causeless_changes(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Explain velocity changes without a cause by contacts with other balls where that lowers the total cost."""
    number, failed = 0, 0
    while number < len(solution.graph.contacts) and failed < MAX_FAILED_TRIALS:
        contact, graph = solution.graph.contacts[number], solution.graph
        key = ("causeless", *graph.cache_key((*contact.before, *contact.after)))
        if contact.kind not in CAUSELESS_KINDS or key in search.required:
            number += 1
            continue
        search.required.add(key)
        cost = search.cost(solution)
        trial = _join_best_partner(solution, search, number)
        is_turn = contact.kind == "free" and not graph.segments[contact.before[0]].static
        if is_turn and (trial is None or search.cost(trial) >= cost):
            trial = _continue_to_cushion(solution, search, number)
        is_better = trial is not None and search.cost(trial) < cost
        failed += trial is not None and not is_better
        solution, number = (trial, 0) if trial is not None and is_better else (solution, number + 1)
    return solution


def _join_best_partner(solution: JointSolution, search: StructureSearch, number: int) -> JointSolution | None:
    """Join a change with the ball whose contact costs least locally; None where every one costs much more.

    Where a ball then turns at a cushion, that is the cause.
    """
    best, least = None, LOCAL_SLACK * search.prices[1]
    for partner in find_partners(solution, search, number):
        joined = join_by_ball_contact(solution, search, number, partner)
        parts = joined and search.refine_differences(solution, solution.graph, joined)
        if parts:
            before, after = map(search.cost, parts)
            if after - before < least:
                best, least = joined, after - before
    if best is None:
        return None
    trial = search.refine(best, solution)
    classified = classify_cushion_turns(trial, search, TURN_TIME_ERROR * search.interval)
    return trial if classified is trial.graph else search.refine(classified, trial)


def _continue_to_cushion(solution: JointSolution, search: StructureSearch, number: int) -> JointSolution | None:
    """Remove a velocity change, and let the ball turn at the cushion that its path then meets.

    None where the path meets none and bends too much to be that of one motion.
    """
    contact = solution.graph.contacts[number]
    excerpt, chosen = solution.graph.extract_contact(number)
    local = search.select_observations(solution.graph, chosen)
    single = search.refine(excerpt.remove_contact(0), solution, LOCAL_ITERATIONS, local)
    k = contact.before[0] - int(contact.after[0] < contact.before[0])
    without = solution.graph.remove_contact(number)
    moving = replace(without.segments[k], static=False, state=single.graph.segments[0].state)
    joined = replace(solution, graph=without.replace_segment(k, moving))
    extended = insert_crossed_cushions(joined, search)
    if extended is joined.graph and contact.gain > LOCAL_SLACK * search.prices[1]:
        return None
    return search.refine(extended, joined)


def collect_hypotheses(solution: JointSolution, search: StructureSearch) -> tuple[ContactRivals, ...]:
    """Collect what may have happened instead of every contact of the graph.

    The contact law of two balls explains nothing where separate velocity changes fit much better.

    Args:
        solution: The best explanation, with C contacts.
        search: Observations and table.

    Returns:
        (C,) rivals of each contact, each refined by itself, and the chi2, at most 0, by which separate changes differ
        from a contact of two balls.
    """
    graph, collected = solution.graph, []
    for number, contact in enumerate(graph.contacts):
        if contact.kind in ("jump", "break"):
            collected.append(ContactRivals((), 0.0))
        elif contact.kind != "ball":
            collected.append(ContactRivals(tuple(_find_rivals(solution, search, number, graph)), 0.0))
        else:
            separate = separate_balls(graph, number)
            apart = replace(solution, graph=separate)
            rivals = [
                one
                for slot in (number, len(separate.contacts) - 1)
                for one in _find_rivals(apart, search, slot, graph)
                if one.other not in graph.balls_at(contact)
            ]
            cost = min(_evaluate_cost(solution, search, separate, graph), 0.0)
            collected.append(ContactRivals(tuple(sorted(rivals, key=lambda one: one.cost)), cost))
    return tuple(collected)


def _find_rivals(
    solution: JointSolution, search: StructureSearch, number: int, best: ContactGraph
) -> list[RivalContact]:
    """Find the other balls that may have caused a velocity change, the best first."""
    segments, rivals = solution.graph.segments, []
    ball = segments[solution.graph.contacts[number].before[0]].ball
    for partner in find_partners(solution, search, number):
        joined = join_by_ball_contact(solution, search, number, partner)
        if joined is not None:
            cost = _evaluate_cost(solution, search, joined, best)
            rivals.append(RivalContact(ball, segments[partner.segment].ball, cost))
    return sorted(rivals, key=lambda one: one.cost)


def _evaluate_cost(solution: JointSolution, search: StructureSearch, other: ContactGraph, best: ContactGraph) -> float:
    """Return the chi2 of another graph minus that of the best one, on the segments that differ."""
    parts = search.refine_differences(solution, best, other)
    return 0.0 if parts is None else parts[1].chi2 - parts[0].chi2
