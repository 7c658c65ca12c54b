"""Two balls that start from rest within one frame interval: one is struck and sends off the other.

No cue strikes twice so soon. Between the two frames neither is detected in motion, and without the contact the fitted
path of the struck ball passes the other. The path of the other gives place and time of the contact.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, JointSolution, Observations
from models.core.scene import Table
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.ball_encounters import total_cost


def resolve_simultaneous_starts(
    solution: JointSolution, observations: Observations, table: Table, prices: tuple[float, float]
) -> JointSolution:
    """Replace simultaneous starts by one strike and a ball contact where that lowers the total cost.

    Either ball may be the struck one. `prices` are those of contacts with a cause and without.
    """
    cost = total_cost(solution, prices)
    for struck, hit in _find_simultaneous_starts(solution.graph, observations.frame_interval):
        connected = _connect_starts(solution, observations, struck, hit, table)
        if connected is None:
            continue
        trial = refine_graph(connected, observations, table, initial=solution)
        if total_cost(trial, prices) < cost:
            return resolve_simultaneous_starts(trial, observations, table, prices)
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


def _connect_starts(
    solution: JointSolution, observations: Observations, struck: int, hit: int, table: Table
) -> ContactGraph | None:
    """Let the ball of the strike `struck` run into that of `hit`; None if that is impossible.

    The hit ball leaves along the line of centres, which gives the place of the other one; both together have the
    momentum of the struck one, which gives the time of the strike.
    """
    graph, struck, hit = _remove_turn(solution.graph, struck, hit, observations.frame_interval)
    first, second = graph.contacts[struck], graph.contacts[hit]
    hit_state = graph.segments[second.after[0]].state
    speed = float(np.hypot(*hit_state[2:4]))
    onward = first.after[0]
    later = np.flatnonzero(
        (observations.ball == graph.segments[onward].ball) & (observations.t > second.t + MIN_CONTACT_INTERVAL)
    )
    if speed < MIN_CONTACT_SPEED or not len(later) or graph.end_time(onward) < observations.t[later[0]]:
        return None
    rest = graph.segments[first.before[0]].state[:2]
    meeting = hit_state[:2] - 2 * table.ball_radius * solution.diameter_factor * hit_state[2:4] / speed
    velocity = (observations.xy[later[0]] - meeting) / (observations.t[later[0]] - second.t)
    after = np.concatenate([meeting, velocity, graph.segments[onward].state[4:]])
    displacement = meeting - rest
    length = float(np.hypot(*displacement))
    impact_speed = float((after[2:4] + hit_state[2:4]) @ displacement) / max(length, 1e-9)
    earlier_times = observations.t[(observations.ball == graph.segments[onward].ball) & (observations.t < second.t)]
    if impact_speed < MIN_CONTACT_SPEED or length < MIN_CONTACT_INTERVAL * impact_speed or not len(earlier_times):
        return None
    t = max(second.t - length / impact_speed, float(earlier_times[-1]))
    if second.t - t < MIN_CONTACT_INTERVAL:
        return None
    segments, contacts, v = list(graph.segments), list(graph.contacts), impact_speed * displacement / length
    new_segment = len(segments)
    segments.append(  # a central hit, as in `segment_priors`
        replace(segments[onward], end=hit, t0=t, state=np.concatenate([rest, v, v, np.zeros(2)]))
    )
    segments[onward] = replace(segments[onward], start=hit, t0=second.t, state=after)
    contacts[struck] = replace(first, t=t, after=(new_segment,))
    contacts[hit] = Contact(
        "ball", second.t, (new_segment, *second.before), (onward, *second.after), gain=first.gain + second.gain
    )
    return ContactGraph(tuple(segments), tuple(contacts)).mark_pushed_strikes()


def _remove_turn(graph: ContactGraph, struck: int, hit: int, interval: float) -> tuple[ContactGraph, int, int]:
    """Remove an unexplained turn of the struck ball within one frame of the other's start: that is their contact."""
    turn = graph.segments[graph.contacts[struck].after[0]].end
    if turn is None or graph.contacts[turn].kind != "free":
        return graph, struck, hit
    if not 0 <= graph.contacts[turn].t - graph.contacts[hit].t < interval:
        return graph, struck, hit
    return graph.remove_contact(turn), struck - (struck > turn), hit - (hit > turn)
