"""Rest before the first motion: a shot that begins within the first frames of a clip.

One frame that shows a ball at rest hardly changes chi2: a ball that comes from just there fits it as well. But a ball
that moves leaves a motion-blur streak, and no ball slows down and then leaves at full speed by itself. So every ball
that moves from its first sample on is also fitted as one that rested there and was struck.

A ball that slid before its first frame was struck later, and harder, than one that rolled: strikes are refitted too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.contact_graph import CAUSELESS_KINDS, Contact, ContactGraph, JointSolution, Observations, Segment
from models.core.scene import Table
from models.core.tracks import Tracks
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import end_state
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.ball_encounters import total_cost
from models.physics.billiards.cloth.closed_form_motion import GRAVITY

# Most samples of a rest that is looked for; a longer one is found by the segmentation.
MAX_REST_SAMPLES = 3
# Parameters that a rest with a strike has beyond a ball that moves already: when, and how far before the next sample.
# They cost what the Bayesian information criterion takes for them. The strike itself costs nothing here: without it,
# the ball was struck as well, before the clip.
REST_PARAMETERS = 2
# Ball radii per frame: a slower ball leaves no streak that can be told from a sharp ball.
MIN_SPEED_RADII = 0.5


def insert_initial_rests(
    solution: JointSolution, observations: Observations, tracks: Tracks, table: Table, prices: tuple[float, float]
) -> JointSolution:
    """Insert the rest and the strike of balls that seem to move from their first sample on.

    Args:
        solution: A refined solution.
        observations: K observations.
        tracks: Tracks that the observations come from, for their streaks.
        prices: chi2 that contacts with a cause and without cost.

    Returns:
        The refined solution of least total cost.
    """
    blur = _sharp_while_fast_share(tracks, table.ball_radius)
    for ball in sorted({segment.ball for segment in solution.graph.segments}):
        samples = int((observations.ball == ball).sum())
        best, least = solution, total_cost(solution, prices) + prices[0] - REST_PARAMETERS * np.log(samples)
        for count in range(1, MAX_REST_SAMPLES + 1):
            graph = _start_from_rest(solution, observations, ball, count)
            if graph is None:
                continue
            trial = refine_graph(graph, observations, table, initial=solution)
            cost = total_cost(trial, prices) + 2 * np.log(blur) * _count_sharp(tracks, ball, count)
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
    strike = float(t[count]) - min(max(way / speed, 0.02 * interval), 0.98 * interval)
    old = graph.segments[first]
    moving = np.concatenate([place, velocity, velocity, np.zeros(2)])
    number = len(graph.contacts)
    states = list(graph.segments)
    states[first] = replace(old, start=number, t0=strike, state=moving)
    states.append(Segment(ball, True, None, number, float(t[0]), np.concatenate([place, np.zeros(6)])))
    contact = Contact("strike", strike, (len(states) - 1,), (first,), gain=0.0)
    return ContactGraph(tuple(states), (*graph.contacts, contact)).mark_pushed_strikes()


def _count_sharp(tracks: Tracks, ball: int, count: int) -> int:
    """Count the sharp ones among the first samples of a ball that moves fast just after them.

    Args:
        tracks: Tracks of all balls.
        ball: Index of the ball.
        count: Number of first samples.

    Returns:
        Sharp ones among them; 0 where no streak follows.
    """
    rows = np.flatnonzero(tracks.is_observed[:, ball])
    streak = np.hypot(*tracks.streak[rows, ball].T)
    return int((streak[:count] == 0).sum()) if len(rows) > count and streak[count : count + 2].max() > 0 else 0


def _sharp_while_fast_share(tracks: Tracks, radius: float) -> float:
    """Estimate the share of sharp detections among those of balls that move fast.

    Args:
        tracks: Tracks of all balls.
        radius: Radius of the balls, m.

    Returns:
        The share, by Laplace's rule of succession.
    """
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


def refit_strikes(solution: JointSolution, observations: Observations, table: Table) -> JointSolution:
    """Refit a graph also from central hits, and select the best solution.

    How far a slide throws a ball back grows with the square of its slip: where no frame shows the slide, no small step
    leads from a ball that rolls at once to one that slides first.

    Args:
        solution: A refined solution.
        observations: K observations.

    Returns:
        The solution of least chi2.
    """
    rolling = [number for number, contact in enumerate(solution.graph.contacts) if _starts_rolling(solution, contact)]
    if not rolling:
        return solution
    start = _set_central_hits(solution, observations, rolling)
    return min([solution, refine_graph(start.graph, observations, table, initial=start)], key=lambda one: one.chi2)


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
    graph = solution.graph
    segments, contacts = list(graph.segments), list(graph.contacts)
    for number in strikes:
        contact, segment = contacts[number], contacts[number].after[0]
        state = segments[segment].state.copy()
        rolling_velocity = state[2:4] - 2 / 7 * state[4:6]
        speed = max(float(np.hypot(*rolling_velocity)), MIN_CONTACT_SPEED)
        v = 7 / 5 * rolling_velocity
        ahead = _slide_displacement(v, solution.friction.sliding) - _slide_displacement(
            state[4:6], solution.friction.sliding
        )
        later_times = observations.t[(observations.ball == segments[segment].ball) & (observations.t > contact.t)]
        until = min(float(later_times[0]) if len(later_times) else np.inf, graph.end_time(segment))
        t = contact.t + min(float(ahead @ rolling_velocity) / speed**2, (1 - MIN_REMAINING_SHARE) * (until - contact.t))
        state[2:4], state[4:6] = v, v
        segments[segment] = replace(segments[segment], t0=t, state=state)
        contacts[number] = replace(contact, t=t)
    return replace(solution, graph=ContactGraph(tuple(segments), tuple(contacts)))


def _slide_displacement(slip: np.ndarray, friction: float) -> np.ndarray:
    """Return the distance (2,) m by which a sliding ball, once it rolls, is ahead of one that rolled at once."""
    return np.asarray(2 / 49 * slip * np.hypot(*slip) / (friction * GRAVITY))
