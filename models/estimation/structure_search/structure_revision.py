"""Revision of a refined contact graph: contacts that were missed, misclassified or false."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.options import REQUIRED_GAIN
from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import assign_observations, end_state
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.ball_encounters import (
    TIME_TOLERANCE,
    ContactProposal,
    SearchCache,
    find_ball_contacts,
    insert_proposals,
    is_doubtful,
    total_cost,
)
from models.estimation.structure_search.contact_chains import complete_chains
from models.estimation.structure_search.contact_partners import explain_causeless_changes
from models.estimation.structure_search.contact_removal import remove_false_contacts
from models.estimation.structure_search.corner_cushions import insert_corner_cushions
from models.estimation.structure_search.initial_rests import MAX_REST_SAMPLES
from models.estimation.structure_search.missed_cushions import (
    classify_cushion_turns,
    insert_crossed_cushions,
    split_corner_contacts,
)
from models.estimation.structure_search.pass_log import log_pass
from models.estimation.structure_search.simultaneous_starts import resolve_simultaneous_starts
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

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
# Successive rounds: one contact often reveals the next.
MAX_INSERTION_ROUNDS = 6


@dataclass(frozen=True, slots=True)
class StructureSearch:
    """What every pass of the search uses."""

    observations: Observations
    table: Table
    prices: tuple[float, float]
    """chi2 that contacts with a cause and without cost."""
    cache: SearchCache


def revise_graph(
    solution: JointSolution,
    observations: Observations,
    table: Table,
    break_price: float,
    free_price: float,
    rounds: int = 3,
) -> JointSolution:
    """Revise a contact graph: reclassify, insert and remove contacts.

    Args:
        solution: A refined solution.
        observations: K observations.
        break_price: chi2 that a contact with a cause costs.
        free_price: chi2 that one without a cause costs.
        rounds: Largest number of rounds.

    Returns:
        The refined solution of the revised graph.
    """
    search = StructureSearch(observations, table, (break_price, free_price), SearchCache())
    for _ in range(rounds):
        inserted = _insert_passing_contacts(solution, observations, table, *search.prices, search.cache)
        before = revised = log_pass("insert passing contacts", solution, inserted, search.prices)
        for name, revise in PASSES:
            revised = log_pass(name, revised, revise(revised, search), search.prices)
        gains = _evaluate_gains(revised, observations, table, search.cache)
        solution = log_pass(
            "remove needless contacts",
            revised,
            _prune_contacts(revised, gains, observations, table, search.prices),
            search.prices,
        )
        if revised is before and len(solution.graph.contacts) == len(gains):
            break
    return solution


def _revise_locally(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Apply the first local revision that changes the graph; keep it if the total cost does not rise too much."""
    observations, table = search.observations, search.table
    graph = classify_cushion_turns(solution, table)
    graph = _pair_unexplained_changes(solution, graph, observations, table)
    graph = _explain_vanished_balls(solution, graph, observations, table)
    graph = split_corner_contacts(solution, graph, table)
    graph = insert_crossed_cushions(solution, graph, observations, table)
    return _refine_if_better(solution, graph, observations, table, search.prices)


def _refine_if_better(
    solution: JointSolution, graph: ContactGraph, observations: Observations, table: Table, prices: tuple[float, float]
) -> JointSolution:
    """Refine a changed graph; keep the old solution if the total cost rises too much."""
    if graph is solution.graph:
        return solution
    trial = refine_graph(graph, observations, table, initial=solution)
    is_better = total_cost(trial, prices) < total_cost(solution, prices) + GRACE_PRICES * prices[0]
    return trial if is_better else solution


def _insert_passing_contacts(
    solution: JointSolution,
    observations: Observations,
    table: Table,
    break_price: float,
    free_price: float,
    cache: SearchCache,
) -> JointSolution:
    """Insert contacts of passing balls as long as new ones come up."""
    changed: frozenset[int] | None = None
    for _ in range(MAX_INSERTION_ROUNDS):
        proposals = find_ball_contacts(solution, observations, table, (break_price, free_price), cache, changed)
        solution, changed = _insert_paying_proposals(
            solution, proposals, observations, table, (break_price, free_price)
        )
        if not changed:
            break
    return solution


def _insert_paying_proposals(
    solution: JointSolution,
    proposals: list[ContactProposal],
    observations: Observations,
    table: Table,
    prices: tuple[float, float],
) -> tuple[JointSolution, frozenset[int]]:
    """Insert the proposals that lower the total cost of the clip; return also the segments that changed.

    If all together do not, half of them are tried, then the others: a contact that is right locally may be wrong for
    what comes before or after.
    """
    if not proposals:
        return solution, frozenset()
    extended, changed = insert_proposals(
        solution, observations, proposals, TIME_TOLERANCE * observations.frame_interval
    )
    if not changed:
        return solution, changed
    trial = refine_graph(extended, observations, table, initial=solution)
    if total_cost(trial, prices) < total_cost(solution, prices):
        return trial, changed
    if len(proposals) == 1:
        return solution, frozenset()
    half = len(proposals) // 2
    solution, one = _insert_paying_proposals(solution, proposals[:half], observations, table, prices)
    rest = [other for other in proposals[half:] if not other.segments & one]
    solution, two = _insert_paying_proposals(solution, rest, observations, table, prices)
    return solution, one | two


# The passes of one round after passing contacts are inserted, in this order; a round that they leave is the last.
PASSES: tuple[tuple[str, Callable[[JointSolution, StructureSearch], JointSolution]], ...] = (
    ("revise locally", _revise_locally),
    ("connect starts", lambda one, s: resolve_simultaneous_starts(one, s.observations, s.table, s.prices)),
    ("explain causeless", lambda one, s: explain_causeless_changes(one, s.observations, s.table, s.prices, s.cache)),
    ("corner cushions", lambda one, s: insert_corner_cushions(one, s.observations, s.table, s.prices)),
    ("complete chains", lambda one, s: complete_chains(one, s.observations, s.table, s.prices, s.cache)),
    ("remove false contacts", lambda one, s: remove_false_contacts(one, s.observations, s.table, s.prices, s.cache)),
)


def remove_unexplained_contacts(
    solution: JointSolution, observations: Observations, table: Table, free_price: float
) -> JointSolution:
    """Remove contacts without a cause that improve less than their price, unless the whole clip needs them.

    Args:
        solution: A refined solution.
        observations: K observations.
        free_price: chi2 that a contact without a cause costs.

    Returns:
        The refined solution without these contacts.
    """
    return _prune_contacts(
        solution, _evaluate_gains(solution, observations, table, SearchCache()), observations, table, (0.0, free_price)
    )


def _prune_contacts(
    solution: JointSolution, gains: FloatArray, observations: Observations, table: Table, prices: tuple[float, float]
) -> JointSolution:
    """Remove the contacts that gain less than their price; `gains` (C,) are stored in the others.

    If the total cost rises, the more needed half of them stays, and so on. Contacts that stay matter beyond their own
    segments: their gain is the loss of the whole clip without them where that is known, else the required one.
    """
    removed = _find_needless_contacts(solution, gains, prices)
    updated_gains = gains.copy()
    updated_gains[removed] = np.maximum(gains[removed], REQUIRED_GAIN)
    graph = _set_gains(solution.graph, gains).mark_pushed_strikes()
    while removed:
        fewer = refine_graph(_remove_contacts(graph, removed), observations, table, initial=solution)
        if total_cost(fewer, prices) < total_cost(solution, prices):
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


def _evaluate_gains(
    solution: JointSolution, observations: Observations, table: Table, cache: SearchCache
) -> FloatArray:
    """Evaluate the chi2 (C,) that every contact improves; `cache` keeps the results while nothing changes."""
    owner, graph, gains = assign_observations(solution.graph, observations), solution.graph, []
    for number, contact in enumerate(graph.contacts):
        key = (contact.kind, contact.cushion, *graph.cache_key((*contact.before, *contact.after)))
        if key not in cache.gains:
            cache.gains[key] = _evaluate_gain(solution, observations, owner, table, number)
        gains.append(cache.gains[key])
    return np.array(gains)


def _evaluate_gain(
    solution: JointSolution, observations: Observations, owner: NDArray[np.int64], table: Table, number: int
) -> float:
    """Evaluate the chi2 that a contact improves on the segments that it joins."""
    contact, segments = solution.graph.contacts[number], solution.graph.segments
    if contact.gain > CERTAIN_GAIN:
        return contact.gain
    excerpt, selection = solution.graph.extract_contact(number)
    rows = np.isin(owner, selection)
    rest = contact.before[0]
    is_short_rest = (
        contact.kind == "strike" and segments[rest].start is None and (owner == rest).sum() <= MAX_REST_SAMPLES
    )
    if any(segments[k].static for k in (*contact.before, *contact.after)) and not is_short_rest:
        return max(contact.gain, CERTAIN_CHANGE)
    if contact.kind != "ball" and min(int((owner == k).sum()) for k in selection) <= 1:
        return (
            refine_graph(
                solution.graph.remove_contact(number), observations, table, iterations=10, initial=solution
            ).chi2
            - solution.chi2
        )
    if rows.sum() < 3:
        return max(contact.gain, CERTAIN_CHANGE)
    local = observations.select_rows(rows)
    whole = excerpt.remove_contact(0)
    states = [_guess_joined_state(excerpt, local, k) for k in range(len(contact.before))]
    whole = ContactGraph(
        tuple(replace(s, static=False, state=state) for s, state in zip(whole.segments, states, strict=True)), ()
    )
    split = refine_graph(excerpt, local, table, iterations=12, initial=solution)
    joined = min(
        refine_graph(w, local, table, iterations=12, initial=solution).chi2 for w in (whole, excerpt.remove_contact(0))
    )
    return joined - split.chi2


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


def _pair_unexplained_changes(
    solution: JointSolution, graph: ContactGraph, observations: Observations, table: Table
) -> ContactGraph:
    """Let balls that start or turn without a cause meet another one that passes."""
    if graph is not solution.graph:
        return graph
    interval = observations.frame_interval
    for number, contact in enumerate(graph.contacts):
        if contact.kind == "strike":
            shorter = _remove_double_start(graph, observations, number, interval) or _merge_double_strike(
                solution, observations, number, interval, table
            )
            if shorter is not None:
                return shorter
        if contact.kind not in ("strike", "free"):
            continue
        passing = _find_passing_segment(solution, contact, table, interval)
        if passing is not None:
            return _merge_into_ball_contact(solution, number, passing)
    return graph


def _explain_vanished_balls(
    solution: JointSolution, graph: ContactGraph, observations: Observations, table: Table
) -> ContactGraph:
    """Let a resting ball that vanishes as another one comes be hit: it was too fast to be detected again."""
    if graph is not solution.graph:
        return graph
    times = np.unique(observations.t)
    interval = float(np.median(np.diff(times)))
    for ball in np.unique(observations.ball):
        k = graph.segments_of_ball(int(ball))[-1]
        end_time = float(observations.t[observations.ball == ball].max()) + 0.5 * interval
        if not graph.segments[k].static or graph.segments[k].end is not None or end_time > times[-1] - 1.5 * interval:
            continue
        probe = Contact("free", end_time, (k,), (k,))
        passing = _find_passing_segment(solution, probe, table, interval)
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
    moving_state = evaluate_kinematics(
        graph.segments[k].state[None], np.array([t - graph.start_time(k)]), solution.friction
    )[0]
    rest_state = graph.segments[resting].state
    line = rest_state[:2] - moving_state[:2]
    line /= np.hypot(*line)
    impulse = 0.95 * max(float(moving_state[2:4] @ line), MIN_CONTACT_SPEED) * line
    if ends_here and end is not None:
        extended = graph.insert_contact(
            Contact("free", t, (resting,), ()), (np.concatenate([rest_state[:2], impulse, impulse, np.zeros(2)]),)
        )
        one, two = extended.contacts[-1], extended.contacts[end]
        hit = Contact("ball", t, (*one.before, *two.before), (*one.after, *two.after), gain=max(100.0, two.gain))
        return extended.merge_contacts(end, len(extended.contacts) - 1, hit)
    states = (
        np.concatenate([rest_state[:2], impulse, impulse, np.zeros(2)]),
        np.concatenate([moving_state, np.zeros(2)]),
    )
    states[1][2:6] -= np.tile(impulse, 2)
    return graph.insert_contact(Contact("ball", t, (resting, k), (), gain=100.0), states)


def _remove_double_start(
    graph: ContactGraph, observations: Observations, number: int, interval: float
) -> ContactGraph | None:
    """Remove a strike within the frame before a ball is hit by another one."""
    first = graph.contacts[number].after[0]
    end = graph.segments[first].end
    if end is None or graph.contacts[end].kind != "ball":
        return None
    hit = graph.contacts[end]
    others = [k for k in hit.before if k != first]
    was_resting = all(graph.segments[k].static for k in graph.contacts[number].before)
    is_moving = not any(graph.segments[k].static for k in others)
    between = (
        (observations.ball == graph.segments[first].ball)
        & (observations.t > graph.start_time(first))
        & (observations.t < hit.t)
    )
    if was_resting and is_moving and (between.sum() <= 1 or hit.t - graph.contacts[number].t < 1.5 * interval):
        return graph.remove_contact(number)
    return None


def _merge_double_strike(
    solution: JointSolution, observations: Observations, number: int, interval: float, table: Table
) -> ContactGraph | None:
    """Merge a second velocity change within the next frame into the strike: a cue pushes for a moment."""
    graph = solution.graph
    first = graph.contacts[number].after[0]
    end = graph.segments[first].end
    if (
        end is None
        or graph.contacts[end].kind != "free"
        or graph.end_time(first) - graph.start_time(first) > 2.2 * interval
    ):
        return None
    between = (
        (observations.ball == graph.segments[first].ball)
        & (observations.t > graph.start_time(first))
        & (observations.t < graph.end_time(first))
    )
    distance = np.linalg.norm(end_state(solution, first)[:2] - graph.segments[first].state[:2])
    is_moving_on = not graph.segments[graph.contacts[end].after[0]].static
    if between.sum() > 1 or distance > table.ball_radius or not is_moving_on:
        return None
    shorter = graph.remove_contact(number)
    index = end if end < number else end - 1
    return shorter.replace_contact(index, replace(shorter.contacts[index], kind="strike"))


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
        begin, end = (
            max(graph.start_time(k), contact.t - 1.5 * interval),
            min(graph.end_time(k), contact.t + 1.5 * interval),
        )
        if end - begin < 1e-3:
            continue
        t = np.linspace(begin, end, 61)
        path = evaluate_kinematics(
            np.repeat(segment.state[None], len(t), axis=0), t - graph.start_time(k), solution.friction
        )
        mismatch = np.abs(np.linalg.norm(path[:, :2] - place, axis=1) - 2 * table.ball_radius)
        # the moment of contact nearest to the given one
        cost = mismatch / (TOUCH_TOLERANCE * table.ball_radius) + 0.5 * np.abs(t - contact.t) / interval
        least = int(np.argmin(cost))
        speed = float(np.hypot(*path[least, 2:4]))
        inner = 0 < least < len(t) - 1 or abs(t[least] - contact.t) < 1.5 * interval
        if (
            mismatch[least] < TOUCH_TOLERANCE * table.ball_radius
            and inner
            and speed > MIN_CONTACT_SPEED
            and (best is None or cost[least] < best[0])
        ):
            best = (float(cost[least]), k, float(t[least]))
    return None if best is None else (best[1], best[2])


def _merge_into_ball_contact(solution: JointSolution, number: int, passing: tuple[int, float]) -> ContactGraph:
    """Replace a velocity change by a contact of two balls."""
    graph, (k, t) = solution.graph, passing
    contact = graph.contacts[number]
    segment = graph.segments[k]
    near_start = segment.start is not None and t - graph.start_time(k) < 2e-3
    near_end = segment.end is not None and graph.end_time(k) - t < 2e-3
    other = segment.start if near_start else segment.end if near_end else None
    if other is not None:
        partner = graph.contacts[other]
        if partner.kind not in ("free", "strike") or other == number:
            return graph
        joined = Contact("ball", partner.t, (*contact.before, *partner.before), (*contact.after, *partner.after))
        return graph.merge_contacts(number, other, replace(joined, gain=contact.gain + partner.gain))
    state = evaluate_kinematics(segment.state[None], np.array([t - graph.start_time(k)]), solution.friction)[0]
    change = graph.segments[contact.after[0]].state[2:4] - end_state(solution, contact.before[0])[2:4]
    after = np.concatenate([state, np.zeros(2)])
    after[2:4] -= change
    after[4:6] -= change
    extended = graph.insert_contact(Contact("free", t, (k,), (), gain=contact.gain), (after,))
    last = len(extended.contacts) - 1
    new_contact = extended.contacts[last]
    joined = Contact(
        "ball", t, (*contact.before, *new_contact.before), (*contact.after, *new_contact.after), gain=contact.gain
    )
    return extended.merge_contacts(number, last, joined)
