"""Detection of break shots in a refined contact graph: balls that lie together and are hit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from models.core.contact_graph import ContactGraph, JointSolution, Observations
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.break_shot.break_simulation import BreakShot
from models.estimation.joint_fit.contact_cascades import evaluate_state, find_segment_at
from models.estimation.joint_fit.fit_solution import evaluate_path
from models.tracking.track_noise import NOISE_FLOOR_RADII

# Balls that lie together, and that start at once: with fewer the contacts are fitted one by one.
MIN_RACK_BALLS, MIN_LEAVING_BALLS = 4, 3
# Ball radii between two surfaces: nearer balls lie together.
RACK_GAP_RADII = 0.25
# Frame intervals within which balls of a rack start.
SIMULTANEOUS_INTERVALS = 3.0
# s for which the incoming ball is tracked.
INCOMING_TIME = 0.5
# Observed time after the hit: ball radii that the incoming ball would go on, at least so many frames, at most so many
# s.
WATCHED_DISTANCE_RADII, MIN_WATCHED_FRAMES, MAX_WATCHED_TIME = 30.0, 4.0, 0.5
# Samples that determine the path of the incoming ball by themselves.
MIN_INCOMING_SAMPLES = 3
# m, and share of its speed: of an incoming ball with fewer samples.
_PLACE_SIGMA, _SPEED_SIGMA = 5e-3, 0.15
# Ball radii: of the place of a resting ball without samples.
_UNOBSERVED_SIGMA_RADII = 0.3
# Samples before the break, and the limit of their median chi2, that decide whether a ball still rests.
_LATEST_SAMPLES, _MAX_REST_CHI2 = 5, 10.0
# Ball radii around a pocket, where nothing is simulated.
_JAW_RADII = 3.0


@dataclass(frozen=True, slots=True)
class _RestingBall:
    """A ball that rests until the break, whatever the graph contains shortly before."""

    ball: int
    place: FloatArray
    """(2,) m."""
    sigma: float
    """m per axis."""


def find_break_shots(solution: JointSolution, observations: Observations, table: Table) -> list[BreakShot]:
    """Find all break shots of a clip.

    Args:
        solution: A refined solution.
        observations: K observations.

    Returns:
        Break shots with their samples, in the order of time.
    """
    graph = solution.graph
    departures = sorted(
        (graph.contacts[segment.end].t, k)
        for k, segment in enumerate(graph.segments)
        if segment.static and segment.end is not None
    )
    if len(departures) < MIN_LEAVING_BALLS:
        return []
    break_shots: list[BreakShot] = []
    interval, end = observations.frame_interval, -np.inf
    for first, _ in departures:
        leaving = {
            graph.segments[k].ball for t, k in departures if first <= t <= first + SIMULTANEOUS_INTERVALS * interval
        }
        if first < end or len(leaving) < MIN_LEAVING_BALLS:
            continue
        resting = _find_resting_balls(solution, observations, first, table)
        rack = _select_racks(resting, leaving, (2 * solution.diameter_factor + RACK_GAP_RADII) * table.ball_radius)
        incoming = rack and _find_incoming_segment(solution, rack, first, SIMULTANEOUS_INTERVALS * interval, table)
        break_shot = incoming and _collect_break_shot(solution, observations, table, *incoming, resting, interval)
        if break_shot:
            break_shots.append(replace(break_shot, rack=tuple(one.ball for one in rack)))
            end = break_shot.end
    return break_shots


def _find_resting_balls(
    solution: JointSolution, observations: Observations, t: float, table: Table
) -> list[_RestingBall]:
    """Find balls that rest until t by their samples; simultaneous contacts distort the fitted path starts."""
    graph, resting = solution.graph, []
    for ball in sorted({segment.ball for segment in graph.segments}):
        begin = rest_start_time(graph, ball, t)
        rows = np.flatnonzero((observations.ball == ball) & (observations.t >= begin) & (observations.t < t))
        if len(rows):
            place, sigma, is_resting = _estimate_rest_place(observations, rows)
        else:
            k = find_segment_at(graph, ball, t)
            place, is_resting = graph.segments[k].state[:2].copy(), graph.segments[k].static
            sigma = _UNOBSERVED_SIGMA_RADII * table.ball_radius
        if is_resting:
            resting.append(_RestingBall(ball, place, float(np.hypot(sigma, NOISE_FLOOR_RADII * table.ball_radius))))
    return resting


def rest_start_time(graph: ContactGraph, ball: int, t: float) -> float:
    """Return the time from which a ball rests at t.

    Args:
        graph: The contact graph.
        t: s.

    Returns:
        s: the start of its rest in the graph, or a while before t.
    """
    resting = [k for k in graph.segments_of_ball(ball) if graph.segments[k].static and graph.start_time(k) < t]
    if resting and graph.end_time(resting[-1]) > t - INCOMING_TIME:
        return min(graph.start_time(resting[-1]), t)
    return max(graph.start_time(find_segment_at(graph, ball, t - INCOMING_TIME)), t - INCOMING_TIME)


def _estimate_rest_place(observations: Observations, rows: IntArray) -> tuple[FloatArray, float, bool]:
    """Estimate the place (2,) m of a resting ball, its sigma, m per axis, and whether the samples agree."""
    information = np.einsum("kij,kil->kjl", observations.whiten[rows], observations.whiten[rows])
    covariance = np.linalg.inv(information.sum(axis=0))
    place = covariance @ np.einsum("kij,kj->i", information, observations.xy[rows])
    size = (np.einsum("kij,kj->ki", observations.whiten[rows], observations.xy[rows] - place) ** 2).sum(axis=1)
    return place, float(np.sqrt(np.trace(covariance) / 2)), float(np.median(size[-_LATEST_SAMPLES:])) < _MAX_REST_CHI2


def _select_racks(resting: list[_RestingBall], leaving: set[int], reach: float) -> list[_RestingBall]:
    """Select the balls of the groups that lie together, are large enough, and contain enough of the balls `leaving`."""
    places = np.array([one.place for one in resting]).reshape(-1, 2)
    is_near = np.linalg.norm(places[:, None] - places, axis=2) < reach
    _, group = connected_components(is_near, directed=False)
    selected: list[_RestingBall] = []
    for number in np.unique(group):
        members = [resting[k] for k in np.flatnonzero(group == number)]
        if len(members) >= MIN_RACK_BALLS and len({one.ball for one in members} & leaving) >= MIN_LEAVING_BALLS:
            selected += members
    return selected


def _find_incoming_segment(
    solution: JointSolution, rack: list[_RestingBall], t: float, time_tolerance: float, table: Table
) -> tuple[int, float] | None:  # fmt: skip
    """Find the first segment whose continued path meets the rack within `time_tolerance` s of t, and when."""
    graph, radius = solution.graph, table.ball_radius * solution.diameter_factor
    places, members = np.array([one.place for one in rack]), {one.ball for one in rack}
    candidates: list[tuple[float, int]] = []
    for k, segment in enumerate(graph.segments):
        begin = graph.start_time(k)
        if segment.static or segment.ball in members or begin > t or graph.end_time(k) < t - time_tolerance:
            continue
        times = np.linspace(max(begin, t - time_tolerance), t + time_tolerance, 400)
        path = evaluate_path(graph, solution.friction, k, times)
        touching = np.linalg.norm(path[:, None, :2] - places, axis=2).min(axis=1) <= 2 * radius
        if touching.any() and not touching[0]:
            candidates.append((float(times[np.argmax(touching)]), k))
    return (min(candidates)[1], min(candidates)[0]) if candidates else None


def _collect_break_shot(
    solution: JointSolution,
    observations: Observations,
    table: Table,
    incoming: int,
    hit: float,
    resting: list[_RestingBall],
    interval: float,
) -> BreakShot | None:
    """Collect the samples of a break shot with the incoming segment `incoming`; None with too few after the hit."""
    graph = solution.graph
    segment, resting = graph.segments[incoming], [one for one in resting if one.ball != graph.segments[incoming].ball]
    start = max(graph.start_time(incoming), hit - INCOMING_TIME)
    state = evaluate_state(graph, solution.friction, incoming, start)
    speed = float(np.hypot(*state[2:4]))
    window = max(WATCHED_DISTANCE_RADII * table.ball_radius / speed, MIN_WATCHED_FRAMES * interval)
    window = min(window, MAX_WATCHED_TIME)
    balls = (segment.ball, *(one.ball for one in resting))
    selected, numbers = [], []
    for place, ball in enumerate(balls):
        begin, end = start if place == 0 else hit, _observation_end(solution, ball, hit, window)
        rows = np.flatnonzero((observations.ball == ball) & (observations.t >= begin) & (observations.t < end))
        rows = rows[~_is_in_pocket_jaws(observations.xy[rows], table)]
        selected.append(rows)
        numbers.append(np.full(len(rows), place))
    rows, ball_numbers = np.concatenate(selected), np.concatenate(numbers)
    if np.sum(observations.t[rows] > hit) < 2 * len(balls):
        return None
    sigma = np.full(7, np.inf)
    if np.sum(observations.t[selected[0]] < hit) < MIN_INCOMING_SAMPLES:
        sigma[:4] = [_PLACE_SIGMA, _PLACE_SIGMA, _SPEED_SIGMA * speed, _SPEED_SIGMA * speed]
    return BreakShot(
        balls,
        start,
        hit,
        np.append(state[:6], 0.0),
        sigma,
        np.array([one.place for one in resting]),
        np.array([one.sigma for one in resting]),
        observations.t[rows],
        ball_numbers,
        observations.xy[rows],
        observations.whiten[rows],
        interval,
        (solution.friction.sliding, solution.friction.rolling),
        solution.diameter_factor,
        replace(table, pockets=False),
    )


def _observation_end(solution: JointSolution, ball: int, hit: float, window: float) -> float:
    """Return the end, s, of a ball's observation: its first cushion contact after the hit."""
    graph = solution.graph
    cushion_times = [c.t for c in graph.contacts if c.kind == "cushion" and c.t > hit and ball in graph.balls_at(c)]
    return min([hit + window, *cushion_times])


def _is_in_pocket_jaws(xy: FloatArray, table: Table) -> NDArray[np.bool_]:
    """Mark (K,) the places (K, 2) in or before a pocket."""
    if not table.pockets:
        return np.zeros(len(xy), np.bool_)
    distance = np.linalg.norm(xy[:, None] - table.pocket_centres, axis=2)
    return np.asarray(distance.min(axis=1) < _JAW_RADII * table.ball_radius)
