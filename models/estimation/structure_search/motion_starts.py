"""Starts of balls that no frame shows: rests before the first motion, strikes, and hits within one frame interval.

One frame that shows a ball at rest hardly changes chi2: a ball that comes from just there fits it as well. But a ball
that moves leaves a motion-blur streak, and no ball slows down and then leaves at full speed by itself. So every ball
that moves from its first sample on is also fitted as one that rested there and was struck.

A ball that slid before its first frame was struck later, and harder, than one that rolled: strikes are refitted too.

Where two balls start from rest within one frame interval, one is struck and sends off the other: no cue strikes twice
so soon. Between the two frames neither is detected in motion, and without the contact the fitted path of the struck
ball passes the other. The path of the other gives place and time of the contact.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import CAUSELESS_KINDS, Contact, ContactGraph, JointSolution, Observations, Segment
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import end_state
from models.estimation.structure_search.structure_trials import StructureSearch

# Most samples of a rest that is looked for; a longer one is found by the segmentation.
MAX_REST_SAMPLES = 3
# Parameters that a rest with a strike has beyond a ball that moves already: when, and how far before the next sample.
# They cost what the Bayesian information criterion takes for them. The strike itself costs nothing here: without it,
# the ball was struck as well, before the clip.
REST_PARAMETERS = 2
# Ball radii per frame: a slower ball leaves no streak that can be told from a sharp ball.
MIN_SPEED_RADII = 0.5


def insert_initial_rests(solution: JointSolution, search: StructureSearch, tracks: Tracks) -> JointSolution:
    """Insert the rest and the strike of balls that seem to move from their first sample on.

    Args:
        solution: A refined solution.
        search: Observations, table and prices.
        tracks: Tracks that the observations come from; detections without a streak are signs of a rest.

    Returns:
        The refined solution of least total cost.
    """
    blur = _sharp_while_fast_share(tracks, search.table.ball_radius)
    for ball in sorted({segment.ball for segment in solution.graph.segments}):
        samples = int((search.observations.ball == ball).sum())
        best, least = solution, search.cost(solution) + search.prices[0] - REST_PARAMETERS * np.log(samples)
        for count in range(1, MAX_REST_SAMPLES + 1):
            graph = _start_from_rest(solution, search.observations, ball, count)
            if graph is None:
                continue
            trial = search.refine(graph, solution)
            cost = search.cost(trial) + 2 * np.log(blur) * _count_sharp(tracks, ball, count)
            if cost < least:
                best, least = trial, cost
        solution = best
    return solution


def _start_from_rest(solution: JointSolution, observations: Observations, ball: int, count: int) -> ContactGraph | None:
    """Let a ball rest at its first `count` samples and be struck before the next; None where it cannot be."""
    graph, own = solution.graph, observations.ball == ball
    t, xy = observations.t[own], observations.xy[own]
    segments = graph.segments_of_ball(ball)
    if len(t) < count + 2 or graph.segments[segments[0]].static:
        return None
    later, goal = float(t[count + 1]), xy[count + 1]
    # velocity changes between the rest and the second sample after it are the strike, found too late
    while (end := graph.segments[segments[0]].end) is not None and graph.contacts[end].t < later:
        if graph.contacts[end].kind in CAUSELESS_KINDS:
            graph = graph.remove_contact(end)
            segments = graph.segments_of_ball(ball)
        elif graph.contacts[end].t > t[count] + MIN_CONTACT_INTERVAL:
            later, goal = graph.contacts[end].t, end_state(replace(solution, graph=graph), segments[0])[:2]
        else:
            return None
    first = segments[0]
    velocity = (goal - xy[count]) / (later - t[count])
    place = np.median(xy[:count], axis=0)
    way = float(np.hypot(*(xy[count] - place)))
    speed = max(float(np.hypot(*velocity)), 1e-3)
    interval = float(t[count] - t[count - 1])
    strike, number = float(t[count]) - min(max(way / speed, 0.02 * interval), 0.98 * interval), len(graph.contacts)
    moving = np.concatenate([place, velocity, velocity, np.zeros(2)])
    graph = graph.replace_segment(first, replace(graph.segments[first], start=number, t0=strike, state=moving))
    rest = Segment(ball, True, None, number, float(t[0]), np.concatenate([place, np.zeros(6)]))
    contact = Contact("strike", strike, (len(graph.segments),), (first,), gain=0.0)
    return ContactGraph((*graph.segments, rest), (*graph.contacts, contact)).mark_pushed_strikes()


def _count_sharp(tracks: Tracks, ball: int, count: int) -> int:
    """Count the sharp ones among the first samples of a ball that moves fast just after them; 0 without a streak."""
    rows = np.flatnonzero(tracks.is_observed[:, ball])
    streak = np.hypot(*tracks.streak[rows, ball].T)
    return int((streak[:count] == 0).sum()) if len(rows) > count and streak[count : count + 2].max() > 0 else 0


def _sharp_while_fast_share(tracks: Tracks, radius: float) -> float:
    """Estimate the share of sharp detections among those of balls that move fast, by Laplace's rule of succession."""
    fast = sharp = 0
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        step = np.hypot(*np.diff(tracks.xy[rows, ball], axis=0).T)
        is_fast = np.minimum(step[1:], step[:-1]) > 2 * MIN_SPEED_RADII * radius
        fast += int(is_fast.sum())
        sharp += int((is_fast & (np.hypot(*tracks.streak[rows[1:-1], ball].T) == 0)).sum())
    return (sharp + 1) / (fast + 2)


# Slip over speed below which a struck ball resembles a rolling one more than one hit in its middle.
MAX_ROLLING_SLIP = 0.5
# Least share of the time from a strike to the next sample that remains after the strike moves.
MIN_REMAINING_SHARE = 0.1


def refit_strikes(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Refit a graph also from central hits, and select the solution of least chi2.

    How far a slide throws a ball back grows with the square of its slip: where no frame shows the slide, no small step
    leads from a ball that rolls at once to one that slides first.
    """
    rolling = [number for number, contact in enumerate(solution.graph.contacts) if _starts_rolling(solution, contact)]
    if not rolling:
        return solution
    start = _set_central_hits(solution, search.observations, rolling)
    return min([solution, search.refine(start.graph, start)], key=lambda one: one.chi2)


def _starts_rolling(solution: JointSolution, contact: Contact) -> bool:
    """Return whether a struck ball starts almost rolling."""
    segments = solution.graph.segments
    if contact.kind != "strike" or contact.pushed or not segments[contact.before[0]].static:
        return False
    v, slip = np.split(segments[contact.after[0]].state[2:6], 2)
    speed = float(np.hypot(*v))
    return speed > MIN_CONTACT_SPEED and float(slip @ v) < MAX_ROLLING_SLIP * speed**2


def _set_central_hits(solution: JointSolution, observations: Observations, strikes: list[int]) -> JointSolution:
    """Let struck balls slip with all their velocity, and roll on later as they do now."""
    graph, friction = solution.graph, solution.friction.sliding
    for number in strikes:
        contact, k = graph.contacts[number], graph.contacts[number].after[0]
        segment, state = graph.segments[k], graph.segments[k].state.copy()
        rolling_velocity = state[2:4] - 2 / 7 * state[4:6]
        speed = max(float(np.hypot(*rolling_velocity)), MIN_CONTACT_SPEED)
        v = 7 / 5 * rolling_velocity
        ahead = _slide_displacement(v, friction) - _slide_displacement(state[4:6], friction)
        later_times = observations.t[(observations.ball == segment.ball) & (observations.t > contact.t)]
        until = min(float(later_times[0]) if len(later_times) else np.inf, solution.graph.end_time(k))
        t = contact.t + min(float(ahead @ rolling_velocity) / speed**2, (1 - MIN_REMAINING_SHARE) * (until - contact.t))
        state[2:4], state[4:6] = v, v
        graph = graph.replace_segment(k, replace(segment, t0=t, state=state))
        graph = graph.replace_contact(number, replace(contact, t=t))
    return replace(solution, graph=graph)


def _slide_displacement(slip: FloatArray, friction: float) -> FloatArray:
    """Return the distance (2,) m by which a sliding ball, once it rolls, is ahead of one that rolled at once."""
    return np.asarray(2 / 49 * slip * np.hypot(*slip) / (friction * GRAVITY))


def resolve_simultaneous_starts(solution: JointSolution, search: StructureSearch) -> JointSolution:
    """Replace simultaneous starts by one strike and a ball contact where that lowers the total cost.

    Either ball may be the struck one.
    """
    cost = search.cost(solution)
    for struck, hit in _find_simultaneous_starts(solution.graph, search.interval):
        connected = _connect_starts(solution, search, struck, hit)
        trial = None if connected is None else search.refine(connected, solution)
        if trial is not None and search.cost(trial) < cost:
            return resolve_simultaneous_starts(trial, search)
    return solution


def _find_simultaneous_starts(graph: ContactGraph, interval: float) -> list[tuple[int, int]]:
    """Find pairs of contacts, in both orders, at which balls start within one frame interval without being hit."""
    starts = [
        number
        for number, contact in enumerate(graph.contacts)
        if contact.kind == "strike" and graph.segments[contact.before[0]].static
    ]
    return [
        (one, other)
        for one, other in permutations(starts, 2)
        if abs(graph.contacts[one].t - graph.contacts[other].t) < interval
    ]


def _connect_starts(solution: JointSolution, search: StructureSearch, struck: int, hit: int) -> ContactGraph | None:
    """Let the ball of the strike `struck` run into that of `hit`; None if that is impossible.

    The hit ball leaves along the line of centres, which gives the place of the other one; both together have the
    momentum of the struck one, which gives the time of the strike.
    """
    graph, struck, hit = _remove_turn(solution.graph, struck, hit, search.interval)
    first, second, observations = graph.contacts[struck], graph.contacts[hit], search.observations
    hit_state = graph.segments[second.after[0]].state
    speed, onward = float(np.hypot(*hit_state[2:4])), first.after[0]
    is_own = observations.ball == graph.segments[onward].ball
    later = np.flatnonzero(is_own & (observations.t > second.t + MIN_CONTACT_INTERVAL))
    if speed < MIN_CONTACT_SPEED or not len(later) or graph.end_time(onward) < observations.t[later[0]]:
        return None
    rest = graph.segments[first.before[0]].state[:2]
    meeting = hit_state[:2] - 2 * search.table.ball_radius * solution.diameter_factor * hit_state[2:4] / speed
    velocity = (observations.xy[later[0]] - meeting) / (observations.t[later[0]] - second.t)
    after = np.concatenate([meeting, velocity, graph.segments[onward].state[4:]])
    displacement = meeting - rest
    length = float(np.hypot(*displacement))
    impact_speed = float((after[2:4] + hit_state[2:4]) @ displacement) / max(length, 1e-9)
    earlier_times = observations.t[is_own & (observations.t < second.t)]
    if impact_speed < MIN_CONTACT_SPEED or length < MIN_CONTACT_INTERVAL * impact_speed or not len(earlier_times):
        return None
    t = max(second.t - length / impact_speed, float(earlier_times[-1]))
    if second.t - t < MIN_CONTACT_INTERVAL:
        return None
    v, new, old = impact_speed * displacement / length, len(graph.segments), graph.segments[onward]
    struck_segment = replace(old, end=hit, t0=t, state=np.concatenate([rest, v, v, np.zeros(2)]))  # a central hit
    graph = graph.replace_segment(onward, replace(old, start=hit, t0=second.t, state=after))
    before, both = (new, *second.before), (onward, *second.after)
    graph = graph.replace_contact(struck, replace(first, t=t, after=(new,)))
    graph = graph.replace_contact(hit, Contact("ball", second.t, before, both, gain=first.gain + second.gain))
    return ContactGraph((*graph.segments, struck_segment), graph.contacts).mark_pushed_strikes()


def _remove_turn(graph: ContactGraph, struck: int, hit: int, interval: float) -> tuple[ContactGraph, int, int]:
    """Remove an unexplained turn of the struck ball within one frame of the other's start: that is their contact."""
    turn = graph.segments[graph.contacts[struck].after[0]].end
    if turn is None or graph.contacts[turn].kind != "free":
        return graph, struck, hit
    if not 0 <= graph.contacts[turn].t - graph.contacts[hit].t < interval:
        return graph, struck, hit
    return graph.remove_contact(turn), struck - (struck > turn), hit - (hit > turn)
