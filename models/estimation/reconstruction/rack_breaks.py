"""Break shots of a clip: the cluster that bursts, the ball that bursts it, and which of its balls is hit first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.core.contact_graph import CAUSELESS_KINDS, JointSolution, layout_parameters
from models.core.fit_result import RackBreak
from models.core.shot import Shot
from models.estimation.break_shot.break_simulation import BreakShot
from models.estimation.joint_fit.contact_cascades import evaluate_state, find_segment_at
from models.estimation.reconstruction.event_list import NUDGE_RADII
from models.estimation.reconstruction.trajectory_assembly import state_covariance
from models.estimation.shot_hypotheses.event_probability import EventRow
from models.estimation.structure_search.rack_detection import SIMULTANEOUS_INTERVALS, find_break_shots

# Balls that lie in contact, or nearly: a smaller cluster is no rack.
MIN_CLUSTER_BALLS = 6
# Frames before the hit that show where the balls lie.
_LAST_FRAMES = 15
# Paths drawn from the posterior of the incoming ball; so many known contacts limit the other probabilities too.
_DRAWS, _SEED = 400, 1


def find_rack_breaks(shot: Shot, solution: JointSolution) -> tuple[tuple[RackBreak, ...], list[EventRow]]:
    """Find the breaks of a clip, and their first contacts.

    Args:
        solution: Its solution.

    Returns:
        The breaks by time, and the first contact of each where the fit has none.
    """
    ids, breaks, rows = shot.tracks.ids, list[RackBreak](), list[EventRow]()
    for one in shot.breaks:
        rack = {ball for contact in one.contacts for ball in (contact.a, contact.b)} - {one.balls[0]}
        if len(rack) >= MIN_CLUSTER_BALLS:
            t = min(contact.t for contact in one.contacts)
            names = tuple(ids[ball] for ball in sorted(rack))
            breaks.append(RackBreak(_find_rest_start(shot, sorted(rack), t), one.start, t, t, ids[one.balls[0]], names))
    for break_shot in find_break_shots(solution, shot.observations, shot.scene.table):
        if len(break_shot.rack) < MIN_CLUSTER_BALLS or any(
            abs(break_shot.hit - one.t) < break_shot.interval for one in breaks
        ):
            continue
        row = _find_first_contact(solution, break_shot, ids)
        end = row.t + SIMULTANEOUS_INTERVALS * break_shot.interval
        rest = _find_rest_start(shot, break_shot.rack, row.t)
        breaks.append(
            RackBreak(rest, break_shot.start, row.t, end, row.a, tuple(ids[ball] for ball in break_shot.rack))
        )
        if row.contact < 0 or solution.graph.contacts[row.contact].kind in CAUSELESS_KINDS:
            rows.append(row)
    return tuple(sorted(breaks, key=lambda one: one.t)), rows


def _find_rest_start(shot: Shot, rack: Sequence[int], hit: float) -> float:
    """Find since when all balls of a rack stay where they lie before the hit, s."""
    tracks = shot.fitted_tracks
    xy = tracks.xy[tracks.t < hit][:, rack]  # (T, N, 2)
    away = (
        np.linalg.norm(xy - np.nanmedian(xy[-_LAST_FRAMES:], axis=0), axis=2)
        > NUDGE_RADII * shot.scene.table.ball_radius
    )
    return float(tracks.t[: len(xy)][away.any(axis=1)].max(initial=tracks.t[0] - 1.0))


def _find_first_contact(solution: JointSolution, break_shot: BreakShot, ids: tuple[str, ...]) -> EventRow:
    """Find the ball that the incoming one meets first by its path: how the cluster bursts shows nothing of it."""
    graph, ball = solution.graph, break_shot.balls[0]
    k = find_segment_at(graph, ball, (break_shot.start + break_shot.hit) / 2)
    begin = max(graph.start_time(k), break_shot.hit - break_shot.interval)
    state = evaluate_state(graph, solution.friction, k, begin)[:4]
    covariance = state_covariance(solution, layout_parameters(graph), k, np.array([begin - graph.start_time(k)]))[0]
    rng, reach = np.random.default_rng(_SEED), 2 * break_shot.diameter * break_shot.table.ball_radius
    draws = state + rng.multivariate_normal(np.zeros(4), covariance, _DRAWS, method="eigh")  # (D, 4)
    places = break_shot.rest_places + break_shot.rest_sigma[:, None] * rng.normal(
        size=(_DRAWS, *break_shot.rest_places.shape)
    )
    speed = np.hypot(*draws[:, 2:].T)[:, None]
    way = places - draws[:, None, :2]  # (D, N, 2)
    along = np.einsum("dni,di->dn", way, draws[:, 2:] / speed)
    aside = (way**2).sum(axis=2) - along**2
    delay = np.where(aside < reach**2, along - np.sqrt(np.maximum(reach**2 - aside, 0.0)), np.inf) / speed  # (D, N) s
    first = np.where(np.isfinite(delay).any(axis=1), np.argmin(delay, axis=1), -1)
    if first.max() < 0:  # every path passes the cluster: the ball nearest to it is the best guess
        first[:], delay = int(np.bincount(np.argmin(aside, axis=1)).argmax()), along / speed
    best = int(np.bincount(first[first >= 0]).argmax())
    times = begin + delay[first == best, best]
    t, sigma = float(np.median(times)), float(np.std(times))
    state = evaluate_state(graph, solution.friction, k, t)
    normal = (break_shot.rest_places[best] - state[:2]) / reach
    number = graph.segments[k].end
    return EventRow(
        "ball", t, sigma, ids[ball], ids[break_shot.balls[1 + best]], state[:2], "", -1 if number is None else number,
        (int((first == best).sum()) + 1) / (_DRAWS + 2), speed=float(state[2:4] @ normal),
    )  # fmt: skip
