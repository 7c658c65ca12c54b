"""Pocketed balls: tracks that end near a pocket."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.joint_solution import JointSolution
from models.core.scene import POCKETS, Table
from models.core.tracks import Tracks
from models.estimation.shot_hypotheses.event_row import EventRow
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

POCKET_REACH = 3.0
"""Ball radii, plus the way of two frames: a track that ends so near to a pocket has been potted."""


def find_pocketed_balls(solution: JointSolution, tracks: Tracks, table: Table) -> list[EventRow]:
    """Find balls whose tracks end early, in motion, near a pocket."""
    events = []
    last_frame = len(tracks.t) - 1
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if not table.pockets or len(rows) < 2 or rows[-1] > last_frame - 2:
            continue
        segment = solution.graph.segments_of_ball(ball)[-1]
        if solution.graph.segments[segment].static:
            events += _find_fall_from_jaws(solution, tracks, table, ball, segment, rows)
            continue
        events += _find_fall(solution, tracks, table, ball, segment, int(rows[-1]))
    return events


def _find_fall_from_jaws(
    solution: JointSolution, tracks: Tracks, table: Table, ball: int, segment: int, rows: NDArray[np.int64]
) -> list[EventRow]:
    """Find the fall of a ball that stops in the jaws for up to three frames, then is gone."""
    graph, interval = solution.graph, float(np.median(np.diff(tracks.t)))
    last = float(tracks.t[rows[-1]])
    distance = np.linalg.norm(table.pocket_centres - tracks.xy[rows[-1], ball], axis=1)
    pocket = int(np.argmin(distance))
    waited = last - graph.start_time(segment)
    if (
        graph.segments[segment].start is None
        or waited > 3 * interval
        or distance[pocket] > POCKET_REACH * table.ball_radius
    ):
        return []
    x = tracks.xy[rows[-1], ball]
    return [EventRow("pocket", last + 0.5 * interval, interval, tracks.ids[ball], POCKETS[pocket], x, "vanish")]


def _find_fall(
    solution: JointSolution, tracks: Tracks, table: Table, ball: int, segment: int, row: int
) -> list[EventRow]:
    """Find the fall of a ball whose path leads into a pocket."""
    graph, interval = solution.graph, float(np.median(np.diff(tracks.t)))
    state, begin = graph.segments[segment].state, graph.start_time(segment)
    t = max(float(tracks.t[row]), begin) + np.linspace(0, 8 * interval, 161)
    path = evaluate_kinematics(np.repeat(state[None], len(t), axis=0), t - begin, solution.friction)
    speed = float(np.hypot(*path[0, 2:4]))
    distance = np.linalg.norm(path[:, None, :2] - table.pocket_centres, axis=2)  # (161, 6)
    pocket = int(np.argmin(distance.min(axis=0)))
    here = float(np.linalg.norm(tracks.xy[row, ball] - table.pocket_centres[pocket]))
    reach = POCKET_REACH * table.ball_radius
    if here > reach + 2 * interval * speed or distance[:, pocket].min() > reach or speed < 0.02:
        return []
    inside = np.flatnonzero(distance[:, pocket] < max(1.0 * table.ball_radius, distance[:, pocket].min() + 1e-4))
    when = float(t[inside[0]])
    sigma = max(0.5 * interval, 0.5 * table.ball_radius / max(speed, 0.05))
    return [
        EventRow("pocket", when, sigma, tracks.ids[ball], POCKETS[pocket], path[inside[0], :2], "fall", speed=speed)
    ]  # fmt: skip
