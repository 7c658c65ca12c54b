"""Completion of tracks: detections that the tracker left out, in gaps and before or after a track.

A tracker that goes forward in time needs some frames before it knows a ball, and a shot may begin earlier. Later the
balls and their colours are known, and their number is fixed: where one is missing, the most probable chain of unused
detections that leads from its last place to its next one is added. Chains are found by dynamic programming; the
costs are negative log likelihood ratios against "these detections are clutter", as in `assignment_cost`.
"""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.tracking.assignment_cost import (
    CLOTH_COLOUR_DISTANCE,
    CLUTTER_DENSITY,
    DETECTION_PROBABILITY,
    LONG_STREAK_COST,
    MAX_CLOTH_SHARE,
    MAX_COLOUR_COST,
    STRIKE_SPEED,
)
from models.tracking.clutter_filter import STREAK_EXCESS_RADII
from models.tracking.table_detections import TableDetections
from models.tracking.tracklet_linking import MAX_SPEED, Tracklet, count_leaps, ends_in_pocket, make_tracklet

# Probability that a ball of which detections are missing rests between two of them.
REST_PROBABILITY = 0.6
# Ball radii: scatter of the detections of a resting ball that a hand or a cue partly hides.
JITTER_RADII = 0.05
# CIE Lab: least standard deviation of a ball's colour between frames.
MIN_COLOUR_SIGMA = 6.0


def complete_tracks(
    balls: list[Tracklet], clutter: list[Tracklet], detections: TableDetections, t: FloatArray, table: Table
) -> list[Tracklet]:
    """Add to each ball the unused detections that fill its gaps, and those before its first and after its last one.

    Args:
        balls: The tracks of all balls.
        clutter: Tracklets that move like no ball, whose detections are not used.
        detections: Detections of T frames on the table.
        t: (T,) times of the frames, s.

    Returns:
        The tracks in the same order. No detection belongs to two balls.
    """
    is_used = np.zeros(len(detections.row), bool)
    for tracklet in (*balls, *clutter):
        is_used[tracklet.row] = True
    frame_of = np.repeat(np.arange(len(t)), np.diff(detections.first))
    completed = list(balls)
    for number in sorted(range(len(balls)), key=lambda k: -len(balls[k].row)):
        ball = balls[number]
        leaps = count_leaps(ball.frame_index, ball.row, detections, t, table.ball_radius)
        for before, after in _list_gaps(ball, len(t), ends_in_pocket(ball, table)):
            begin = 0 if before is None else int(ball.frame_index[before]) + 1
            end = len(t) if after is None else int(ball.frame_index[after])
            rows = np.arange(detections.first[begin], detections.first[end])
            rows = rows[~is_used[rows]]
            anchors = tuple(None if k is None else int(ball.row[k]) for k in (before, after))
            chain = _find_best_chain(ball, rows, anchors, detections, frame_of, t, table)
            rows = np.sort(np.concatenate([completed[number].row, np.array(chain, np.int64)]))
            # what rests elsewhere meanwhile is another body
            if chain and count_leaps(frame_of[rows], rows, detections, t, table.ball_radius) <= leaps:
                is_used[chain] = True
                completed[number] = make_tracklet(frame_of[rows], rows, detections, t)
    return completed


def _list_gaps(ball: Tracklet, frame_count: int, is_pocketed: bool) -> list[tuple[int | None, int | None]]:
    """List the gaps of a track as pairs of the positions in it before and after; None at either end of the clip."""
    inner = np.flatnonzero(np.diff(ball.frame_index) > 1)
    gaps: list[tuple[int | None, int | None]] = [(int(k), int(k) + 1) for k in inner]
    if ball.frame_index[0] > 0:
        gaps.append((None, 0))
    if ball.frame_index[-1] < frame_count - 1 and not is_pocketed:
        gaps.append((len(ball.row) - 1, None))
    return gaps


def _find_best_chain(
    ball: Tracklet,
    rows: IntArray,
    anchors: tuple[int | None, ...],
    detections: TableDetections,
    frame_of: IntArray,
    t: FloatArray,
    table: Table,
) -> list[int]:
    """Find the chain of the detections `rows` (K,) that is most probable for a ball between two of its detections.

    Args:
        ball: The track.
        rows: Unused detections of the frames in the gap, in the order of time.
        anchors: Detections of the ball before and after the gap; None at an end of the clip.
        frame_of: Frame of each detection.
        t: (T,) s.

    Returns:
        Rows of the chain; empty where no chain is more probable than clutter.
    """
    if not len(rows):
        return []
    before, after = anchors
    missed = -np.log(1 - DETECTION_PROBABILITY)
    own = _colour_costs(ball, rows, detections) - np.log(DETECTION_PROBABILITY) + np.log(CLUTTER_DENSITY) - missed
    best = np.full(len(rows), np.inf)
    previous = np.full(len(rows), -1, np.int64)
    area = float(np.log(table.length * table.width))
    for j, row in enumerate(rows):
        best[j] = area if before is None else _step_cost(before, int(row), detections, frame_of, t, table)
        for i in np.flatnonzero(frame_of[rows[:j]] < frame_of[row]):
            cost = best[i] + _step_cost(int(rows[i]), int(row), detections, frame_of, t, table)
            if cost < best[j]:
                best[j], previous[j] = cost, i
        best[j] += own[j]
    total = best.copy()
    empty = 0.0
    if after is not None:
        total += [_step_cost(int(row), after, detections, frame_of, t, table) for row in rows]
        empty = area if before is None else _step_cost(before, after, detections, frame_of, t, table)
    k = int(np.argmin(total))
    chain: list[int] = []
    if total[k] < empty:
        while k >= 0:
            chain.append(int(rows[k]))
            k = int(previous[k])
    return chain[::-1]


def _step_cost(
    one: int, two: int, detections: TableDetections, frame_of: IntArray, t: FloatArray, table: Table
) -> float:
    """Return the negative log density (1/m^2) of a ball at detection `two`, seen before at `one`."""
    dt = float(t[frame_of[two]] - t[frame_of[one]])
    distance = float(np.hypot(*(detections.xy[two] - detections.xy[one])))
    if distance > MAX_SPEED * dt + table.ball_radius:
        return np.inf
    lengths = np.hypot(*detections.streak[[one, two]].T)  # either neighbour may be the one that a streak leads to
    streak_cost = LONG_STREAK_COST / 2 * float((lengths > distance + STREAK_EXCESS_RADII * table.ball_radius).sum())
    still = (
        detections.sigma_along[one] ** 2 + detections.sigma_along[two] ** 2 + (JITTER_RADII * table.ball_radius) ** 2
    )
    reach = (STRIKE_SPEED * dt / 2) ** 2 + still
    rest = np.log(REST_PROBABILITY) - distance**2 / (2 * still) - np.log(2 * np.pi * still)
    # a heavy tail, as in the tracker: fast balls are rare, and no displacement is impossible
    moved = np.log(1 - REST_PROBABILITY) - 1.5 * np.log1p(distance**2 / reach) - np.log(2 * np.pi * reach)
    return streak_cost - float(np.logaddexp(rest, moved))


def _colour_costs(ball: Tracklet, rows: IntArray, detections: TableDetections) -> FloatArray:
    """Return the costs (K,) of the colours of detections for a ball whose motion may mix the cloth's colour in."""
    difference, fade = detections.colour[rows] - ball.colour, detections.cloth - ball.colour
    share = np.clip(difference @ fade / max(float(fade @ fade), 1e-9), 0.0, MAX_CLOTH_SHARE)
    distance = ((difference - share[:, None] * fade) ** 2).sum(axis=1) / max(ball.spread, MIN_COLOUR_SIGMA) ** 2
    is_cloth = np.hypot.reduce(detections.colour[rows] - detections.cloth, axis=1) < CLOTH_COLOUR_DISTANCE
    is_distinct = float(np.hypot.reduce(fade)) > 2 * CLOTH_COLOUR_DISTANCE
    # no motion mixes in so much of the cloth's colour that a ball of another colour looks like the cloth
    return np.where(is_cloth & is_distinct, np.inf, np.minimum(distance / 2, MAX_COLOUR_COST))
