"""Revision of a refined contact graph: contacts that were missed, misclassified or false."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.options import REQUIRED_GAIN
from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import assign_observations, end_state, evaluate_path
from models.estimation.structure_search.ball_encounters import (
    complete_chains,
    insert_passing_contacts,
    remove_false_contacts,
)
from models.estimation.structure_search.contact_partners import explain_causeless_changes
from models.estimation.structure_search.missed_cushions import (
    classify_cushion_turns,
    insert_corner_cushions,
    insert_crossed_cushions,
    split_corner_contacts,
)
from models.estimation.structure_search.motion_starts import MAX_REST_SAMPLES, resolve_simultaneous_starts
from models.estimation.structure_search.structure_trials import (
    LOCAL_ITERATIONS,
    TRIAL_ITERATIONS,
    StructureSearch,
    is_doubtful,
    join_changes,
)

# Ball radii: two balls so far from touching may have met where one of them changes its velocity.
TOUCH_TOLERANCE = 0.5
# s: a contact so shortly before a velocity change is its cause.
END_TOLERANCE = 0.03
# chi2: a contact that improves so much is not evaluated again.
CERTAIN_GAIN = 3000.0
# chi2 that stands for the gain of a stop, or of a start from rest, which is not evaluated; but it is where the rest is
# as short as `MAX_REST_SAMPLES` at the start of a clip: a ball that comes from there may fit as well.
CERTAIN_CHANGE = 1e3
# Prices by which local revisions may raise the total cost until needless contacts are removed.
GRACE_PRICES = 3.0


def revise_graph(solution: JointSolution, search: StructureSearch, rounds: int = 3) -> JointSolution:
    """Revise a contact graph: reclassify, insert and remove contacts.

    Args:
        solution: A refined solution.
        search: Observations, table and prices.
        rounds: Largest number of rounds.

    Returns:
        The refined solution of the revised graph.
    """
    for _ in range(rounds):
        inserted = insert_passing_contacts(solution, search)
        before = revised = search.log_pass("insert passing contacts", solution, inserted)
        for name, revise in PASSES:
            revised = search.log_pass(name, revised, revise(revised, search))
        gains = _evaluate_gains(revised, search)
        solution = search.log_pass("remove needless contacts", revised, _prune_contacts(revised, gains, search))
        if revised is before and len(solution.graph.contacts) == len(gains):
            break
    return solution


def _revise_locally(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Apply the first local revision that changes the graph; keep it if the total cost does not rise too much."""
    graph = solution.graph
    for revise in _LOCAL_REVISIONS:
        if graph is solution.graph:
            graph = revise(solution, search)
    graph = split_corner_contacts(solution, graph, search.table)
    if graph is solution.graph:
        graph = insert_crossed_cushions(solution, search)
    if graph is solution.graph:
        return solution
    trial = search.refine(graph, solution)
    return trial if search.cost(trial) < search.cost(solution) + GRACE_PRICES * search.prices[0] else solution


def remove_unexplained_contacts(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Remove contacts without a cause that improve less than their price, unless the whole clip needs them."""
    free = replace(search, prices=(0.0, search.prices[1]))
    return _prune_contacts(solution, _evaluate_gains(solution, free), free)


def _prune_contacts(solution: JointSolution, gains: FloatArray, search: StructureSearch) -> JointSolution:
    """Remove the contacts that gain less than their price; `gains` (C,) are stored in the others.

    If the total cost rises, the more needed half of them stays, and so on. Contacts that stay matter beyond their own
    segments: their gain is the loss of the whole clip without them where that is known, else the required one.
    """
    removed = _find_needless_contacts(solution, gains, search.prices)
    updated_gains = gains.copy()
    updated_gains[removed] = np.maximum(gains[removed], REQUIRED_GAIN)
    graph = _set_gains(solution.graph, gains).mark_pushed_strikes()
    while removed:
        fewer = search.refine(_remove_contacts(graph, removed), solution)
        if search.cost(fewer) < search.cost(solution):
            return fewer
        if len(removed) == 1:
            updated_gains[removed] = np.maximum(updated_gains[removed], fewer.chi2 - solution.chi2)
        removed = removed[: len(removed) // 2]
    return replace(solution, graph=_set_gains(solution.graph, updated_gains).mark_pushed_strikes())


def _find_needless_contacts(solution: JointSolution, gains: FloatArray, prices: tuple[float, float]) -> list[int]:
    """Find the contacts that gain less than their price, the most needless first; no two of the same segment."""
    contacts = solution.graph.contacts
    limits = np.array([prices[is_doubtful(solution, c)] for c in contacts])
    used: set[int] = set()
    removed = []
    for k in (int(k) for k in np.argsort(gains) if gains[k] < limits[k]):
        around = {*contacts[k].before, *contacts[k].after}
        if not used & around:  # neighbours are tried later: without this one they may be needed
            used |= around
            removed.append(k)
    return removed


def _set_gains(graph: ContactGraph, gains: FloatArray) -> ContactGraph:
    """Store gains (C,) in the contacts of a graph."""
    return ContactGraph(
        graph.segments, tuple(replace(c, gain=float(g)) for c, g in zip(graph.contacts, gains, strict=True))
    )


def _remove_contacts(graph: ContactGraph, contacts: list[int]) -> ContactGraph:
    """Remove several contacts of a graph."""
    for k in sorted(contacts, reverse=True):
        graph = graph.remove_contact(k)
    return graph.mark_pushed_strikes()


def _evaluate_gains(solution: JointSolution, search: StructureSearch) -> FloatArray:
    """Evaluate the chi2 (C,) that every contact improves; the search keeps the results while nothing changes."""
    owner, graph, gains = assign_observations(solution.graph, search.observations), solution.graph, []
    for number, contact in enumerate(graph.contacts):
        key = (contact.kind, contact.cushion, *graph.cache_key((*contact.before, *contact.after)))
        if key not in search.gains:
            search.gains[key] = _evaluate_gain(solution, search, owner, number)
        gains.append(search.gains[key])
    return np.array(gains)


def _evaluate_gain(solution: JointSolution, search: StructureSearch, owner: NDArray[np.int64], number: int) -> float:
    """Evaluate the chi2 that a contact improves on the segments that it joins."""
    contact, segments = solution.graph.contacts[number], solution.graph.segments
    if contact.gain > CERTAIN_GAIN:
        return contact.gain
    excerpt, selection = solution.graph.extract_contact(number)
    counts = [int((owner == k).sum()) for k in selection]
    is_short_rest = contact.kind == "strike" and segments[selection[0]].start is None and counts[0] <= MAX_REST_SAMPLES
    if any(segments[k].static for k in selection) and not is_short_rest:
        return max(contact.gain, CERTAIN_CHANGE)
    if contact.kind != "ball" and min(counts) <= 1:
        without = search.refine(solution.graph.remove_contact(number), solution, TRIAL_ITERATIONS)
        return without.chi2 - solution.chi2
    if sum(counts) < 3:
        return max(contact.gain, CERTAIN_CHANGE)
    local = search.observations.select_rows(np.isin(owner, selection))
    plain = excerpt.remove_contact(0)
    states = [_guess_joined_state(excerpt, local, k) for k in range(len(contact.before))]
    guess = tuple(replace(s, static=False, state=state) for s, state in zip(plain.segments, states, strict=True))
    split, *joined = (
        search.refine(graph, solution, LOCAL_ITERATIONS, local).chi2
        for graph in (excerpt, ContactGraph(guess, ()), plain)
    )
    return min(joined) - split


def _guess_joined_state(excerpt: ContactGraph, local: Observations, k: int) -> FloatArray:
    """Guess the state of a segment without the contact at its end, from a polynomial through its samples."""
    segment = excerpt.segments[k]
    rows = local.ball == segment.ball
    t, xy = local.t[rows] - segment.t0, local.xy[rows]
    if len(t) < 3:
        return segment.state
    line = np.polynomial.polynomial.polyfit(t, xy, 2 if len(t) > 3 else 1)
    state = segment.state.copy()
    state[:4] = [*line[0], *line[1]]
    state[4:6] = 0.05 * line[1]
    return state


def _pair_unexplained_changes(solution: JointSolution, search: StructureSearch) -> ContactGraph:
    """Let balls that start or turn without a cause meet another one that passes."""
    graph, interval = solution.graph, search.interval
    for number, contact in enumerate(graph.contacts):
        if contact.kind == "strike":
            shorter = _remove_double_start(graph, search.observations, number, interval) or _merge_double_strike(
                solution, search, number
            )
            if shorter is not None:
                return shorter
        if contact.kind in ("strike", "free"):
            passing = _find_passing_segment(solution, contact, search.table, interval)
            if passing is not None:
                return _merge_into_ball_contact(solution, number, passing)
    return graph


def _explain_vanished_balls(solution: JointSolution, search: StructureSearch) -> ContactGraph:
    """Let a resting ball that vanishes as another one comes be hit: it was too fast to be detected again."""
    graph, observations, interval = solution.graph, search.observations, search.interval
    for ball in np.unique(observations.ball):
        k = graph.segments_of_ball(int(ball))[-1]
        end_time = float(observations.t[observations.ball == ball].max()) + 0.5 * interval
        is_last = end_time > observations.t.max() - 1.5 * interval
        if graph.segments[k].static and graph.segments[k].end is None and not is_last:
            probe = Contact("free", end_time, (k,), (k,))
            passing = _find_passing_segment(solution, probe, search.table, interval)
            if passing is not None:
                return _insert_hit_away(solution, k, passing)
    return graph


def _insert_hit_away(solution: JointSolution, resting: int, passing: tuple[int, float]) -> ContactGraph:
    """Let the resting ball leave along the line of centres with the momentum of the other one."""
    graph, (k, t) = solution.graph, passing
    end = graph.segments[k].end
    ends_here = end is not None and graph.contacts[end].kind == "free" and graph.end_time(k) - t < END_TOLERANCE
    if ends_here:
        t = graph.end_time(k)
    elif min(t - graph.start_time(k), graph.end_time(k) - t) < 2e-3:
        return graph
    moving_state = evaluate_path(graph, solution.friction, k, np.array([t]))[0]
    rest_state = graph.segments[resting].state
    line = rest_state[:2] - moving_state[:2]
    line /= np.hypot(*line)
    impulse = 0.95 * max(float(moving_state[2:4] @ line), MIN_CONTACT_SPEED) * line
    sent_off = np.concatenate([rest_state[:2], impulse, impulse, np.zeros(2)])
    if ends_here and end is not None:
        free = Contact("free", t, (resting,), (), gain=max(100.0 - graph.contacts[end].gain, 0.0))
        return join_changes(graph.insert_contact(free, (sent_off,)), len(graph.contacts), end, t, keep=end)
    onward = np.concatenate([moving_state, np.zeros(2)])
    onward[2:6] -= np.tile(impulse, 2)
    return graph.insert_contact(Contact("ball", t, (resting, k), (), gain=100.0), (sent_off, onward))


def _remove_double_start(
    graph: ContactGraph, observations: Observations, number: int, interval: float
) -> ContactGraph | None:
    """Remove a strike within the frame before a ball is hit by another one."""
    strike, first = graph.contacts[number], graph.contacts[number].after[0]
    end = graph.segments[first].end
    if end is None or graph.contacts[end].kind != "ball":
        return None
    hit = graph.contacts[end]
    was_resting = all(graph.segments[k].static for k in strike.before)
    is_moving = not any(graph.segments[k].static for k in hit.before if k != first)
    is_short = _count_between(graph, observations, first) <= 1 or hit.t - strike.t < 1.5 * interval
    return graph.remove_contact(number) if was_resting and is_moving and is_short else None


def _merge_double_strike(solution: JointSolution, search: StructureSearch, number: int) -> ContactGraph | None:
    """Merge a second velocity change within the next frame into the strike: a cue pushes for a moment."""
    graph = solution.graph
    first = graph.contacts[number].after[0]
    end, duration = graph.segments[first].end, graph.end_time(first) - graph.start_time(first)
    if end is None or graph.contacts[end].kind != "free" or duration > 2.2 * search.interval:
        return None
    distance = np.linalg.norm(end_state(solution, first)[:2] - graph.segments[first].state[:2])
    is_moving_on = not graph.segments[graph.contacts[end].after[0]].static
    is_shown = _count_between(graph, search.observations, first) > 1
    if is_shown or distance > search.table.ball_radius or not is_moving_on:
        return None
    shorter = graph.remove_contact(number)
    index = end if end < number else end - 1
    return shorter.replace_contact(index, replace(shorter.contacts[index], kind="strike"))


def _count_between(graph: ContactGraph, observations: Observations, k: int) -> int:
    """Count the samples of a ball within a segment."""
    is_later, is_earlier = observations.t > graph.start_time(k), observations.t < graph.end_time(k)
    return int(np.sum((observations.ball == graph.segments[k].ball) & is_later & is_earlier))


def _find_passing_segment(
    solution: JointSolution, contact: Contact, table: Table, interval: float
) -> tuple[int, float] | None:
    """Find the segment of another ball that touches at a contact, and when."""
    graph = solution.graph
    place = graph.segments[contact.after[0]].state[:2]
    best: tuple[float, int, float] | None = None
    for k, segment in enumerate(graph.segments):
        if segment.static or segment.ball == graph.segments[contact.before[0]].ball:
            continue
        begin = max(graph.start_time(k), contact.t - 1.5 * interval)
        end = min(graph.end_time(k), contact.t + 1.5 * interval)
        if end - begin < 1e-3:
            continue
        t = np.linspace(begin, end, 61)
        path = evaluate_path(graph, solution.friction, k, t)
        mismatch = np.abs(np.linalg.norm(path[:, :2] - place, axis=1) - 2 * table.ball_radius)
        # the moment of contact nearest to the given one
        cost = mismatch / (TOUCH_TOLERANCE * table.ball_radius) + 0.5 * np.abs(t - contact.t) / interval
        least = int(np.argmin(cost))
        is_inner = 0 < least < len(t) - 1 or abs(t[least] - contact.t) < 1.5 * interval
        touches = is_inner and mismatch[least] < TOUCH_TOLERANCE * table.ball_radius
        is_moving = np.hypot(*path[least, 2:4]) > MIN_CONTACT_SPEED
        if touches and is_moving and (best is None or cost[least] < best[0]):
            best = (float(cost[least]), k, float(t[least]))
    return None if best is None else (best[1], best[2])


def _merge_into_ball_contact(solution: JointSolution, number: int, passing: tuple[int, float]) -> ContactGraph:
    """Replace a velocity change by a contact of two balls."""
    graph, (k, t) = solution.graph, passing
    contact, segment = graph.contacts[number], graph.segments[k]
    near_start = segment.start is not None and t - graph.start_time(k) < 2e-3
    near_end = segment.end is not None and graph.end_time(k) - t < 2e-3
    other = segment.start if near_start else segment.end if near_end else None
    if other is not None:
        is_free = graph.contacts[other].kind in ("free", "strike") and other != number
        return join_changes(graph, number, other, graph.contacts[other].t, keep=number) if is_free else graph
    state = evaluate_path(graph, solution.friction, k, np.array([t]))[0]
    change = graph.segments[contact.after[0]].state[2:4] - end_state(solution, contact.before[0])[2:4]
    after = np.concatenate([state, np.zeros(2)])
    after[2:4] -= change
    after[4:6] -= change
    extended = graph.insert_contact(Contact("free", t, (k,), ()), (after,))
    return join_changes(extended, number, len(graph.contacts), t, keep=number)


# Local revisions, of which the first one that changes the graph counts.
_LOCAL_REVISIONS: tuple[Callable[[JointSolution, StructureSearch], ContactGraph], ...] = (
    classify_cushion_turns, _pair_unexplained_changes, _explain_vanished_balls,
)  # fmt: skip
# The passes of one round after passing contacts are inserted, in this order; a round that they leave is the last.
PASSES: tuple[tuple[str, Callable[[JointSolution, StructureSearch], JointSolution]], ...] = (
    ("revise locally", _revise_locally),
    ("connect starts", resolve_simultaneous_starts),
    ("explain causeless", explain_causeless_changes),
    ("corner cushions", insert_corner_cushions),
    ("complete chains", complete_chains),
    ("remove false contacts", remove_false_contacts),
)
