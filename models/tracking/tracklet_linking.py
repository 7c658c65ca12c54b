"""Linking of tracklets over gaps: which one continues where another ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.tracking.table_detections import TableDetections

# m/s, a hard break.
MAX_SPEED = 12.0
# m/s below which a ball rests, whose velocity is known to 0.03; and m/s2 by which one slows down: sliding has 2, and
# cushions take their share.
REST_SPEED, MAX_DECELERATION = 0.1, 3.0
# Radii from the centre of another ball within which a ball may be stopped: two, and the way of a frame.
STOP_RADII = 3.5
# Frames without a detection that end a tracklet, and the fewest detections of one.
MAX_GAP_FRAMES, MIN_DETECTIONS = 4, 3
# Frames in which a resting ball may be detected twice, as one of its tracklets ends and the next begins.
MAX_OVERLAP_FRAMES = 3
# Cost above which two tracklets are two balls; it is high because balls do not appear.
MAX_LINK_COST = 30.0
# Upper limit of the cost of different colours; small at one place, where a hand shades the same ball.
MAX_COLOUR_COST, MAX_SAME_PLACE_COLOUR_COST = 25.0, 5.0
# Frames before and after a change of the look, and the CIE Lab distance of their median colours: that of neighbouring
# balls of a set. A ball that shows another side is cut there, and linked again.
LOOK_FRAMES, LOOK_CHANGE = 5, 20.0
_IMPOSSIBLE = 1e6


@dataclass(frozen=True, slots=True)
class Tracklet:
    """M detections of one ball."""

    frame_index: IntArray
    row: IntArray
    """(M,) row in `TableDetections`."""
    colour: FloatArray
    """(3,) median."""
    spread: float
    """Standard deviation of the colour."""
    start: FloatArray
    end: FloatArray
    """(4,) x, y, vx, vy at the first and at the last detection."""


def cut_tracklets(
    chains: list[tuple[IntArray, IntArray]], detections: TableDetections, t: FloatArray
) -> list[Tracklet]:
    """Cut chains of (frame indices, detections) at long gaps, after which clutter may have been picked up.

    They are cut too where the look changes from one frame to the next: the body may be another one from then on.
    """
    tracklets = []
    for frame_index, row in chains:
        is_start = np.diff(frame_index, prepend=-MAX_GAP_FRAMES - 1) > MAX_GAP_FRAMES
        is_start[_find_look_changes(detections.colour[row])] = True
        starts = np.flatnonzero(is_start)
        for first, end in zip(starts, [*starts[1:], len(frame_index)], strict=True):
            if end - first >= MIN_DETECTIONS:
                tracklets.append(make_tracklet(frame_index[first:end], row[first:end], detections, t))
    return tracklets


def _find_look_changes(colour: FloatArray) -> IntArray:
    """Find the detections from which on a chain with colours (M, 3) looks otherwise than before."""
    if len(colour) < 2 * LOOK_FRAMES:
        return np.empty(0, np.int64)
    medians = np.median(np.lib.stride_tricks.sliding_window_view(colour, LOOK_FRAMES, axis=0), axis=2)
    change = np.hypot.reduce(medians[LOOK_FRAMES:] - medians[:-LOOK_FRAMES], axis=1)
    is_peak = (change >= np.append(change[1:], 0)) & (change > np.append(0, change[:-1]))
    return np.flatnonzero(is_peak & (change > LOOK_CHANGE)) + LOOK_FRAMES


def count_leaps(frame_index: IntArray, row: IntArray, detections: TableDetections, t: FloatArray, radius: float) -> int:
    """Count how often detections (M,) leap from rest to rest, farther than a ball gets that no other one stops."""
    xy, count = detections.xy[row], 0
    far = np.hypot(*np.diff(xy, axis=0).T) > _reach_from_rest(np.diff(t[frame_index]), radius)
    for k in np.flatnonzero(far).tolist():
        around = xy[max(k + 1 - MIN_DETECTIONS, 0) : k + 1], xy[k + 1 : k + 1 + MIN_DETECTIONS]
        rests = all(len(part) == MIN_DETECTIONS and np.ptp(part, axis=0).max() < radius / 2 for part in around)
        others = detections.xy[detections.first[frame_index[k]] : detections.first[frame_index[k] + 1]]
        gap = np.hypot(*(others - xy[k + 1]).T) / radius
        count += bool(rests and not ((gap > 1) & (gap < STOP_RADII)).any())
    return count


def _reach_from_rest(seconds: FloatArray | float, radius: float) -> FloatArray | float:
    """Return how far, m, a ball gets that is struck, and stops by friction, within some seconds."""
    return MAX_DECELERATION * seconds**2 / 2 + 2 * radius


def make_tracklet(frame_index: IntArray, row: IntArray, detections: TableDetections, t: FloatArray) -> Tracklet:
    """Make a tracklet from a chain of detections."""
    colours = detections.colour[row]
    middle = np.median(colours, axis=0)
    spread = float(np.clip(1.4826 * np.median(np.abs(colours - middle)), 3.0, 20.0))
    xy, times = detections.xy[row], t[frame_index]
    return Tracklet(
        frame_index, row, middle, spread, _end_state(xy[:4], times[:4], 0), _end_state(xy[-4:], times[-4:], -1)
    )


def _end_state(xy: FloatArray, t: FloatArray, at: int) -> FloatArray:
    """Estimate place and velocity (4,) at one end of a few samples."""
    if len(t) < 2:
        return np.concatenate([xy[at], np.zeros(2)])
    tau = t - t[at]
    slope, place = np.polynomial.polynomial.polyfit(tau, xy, 1)[::-1]
    return np.concatenate([place, slope])


def link_tracklets(
    tracklets: list[Tracklet], detections: TableDetections, t: FloatArray, table: Table
) -> list[Tracklet]:
    """Join tracklets over gaps by the assignment of least total cost."""
    n = len(tracklets)
    if not n:
        return []
    cost = np.full((n, 2 * n), _IMPOSSIBLE)
    cost[:, n:] = MAX_LINK_COST / 2
    for i, before in enumerate(tracklets):
        for j, after in enumerate(tracklets):
            if _can_follow(before, after, table):
                cost[i, j] = _link_cost(before, after, t, table) - MAX_LINK_COST / 2
    rows, columns = linear_sum_assignment(cost)
    follower = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if j < n and cost[i, j] < MAX_LINK_COST / 2}
    heads = sorted(set(range(n)) - set(follower.values()))
    return [_join_tracklets([tracklets[i] for i in _follow_links(head, follower)], detections, t) for head in heads]


def _can_follow(before: Tracklet, after: Tracklet, table: Table) -> bool:
    """Return whether a tracklet begins where the other has ended, or overlaps its last moments at the same place."""
    overlap = int(before.frame_index[-1]) - int(after.frame_index[0])
    if overlap < 0:
        return True
    later = before.frame_index[0] < after.frame_index[0] and before.frame_index[-1] < after.frame_index[-1]
    distance = float(np.hypot(*(after.start[:2] - before.end[:2])))
    return bool(later and overlap < MAX_OVERLAP_FRAMES and distance < table.ball_radius)


def _follow_links(head: int, follower: dict[int, int]) -> list[int]:
    chain = [head]
    while chain[-1] in follower:
        chain.append(follower[chain[-1]])
    return chain


def _join_tracklets(tracklets: list[Tracklet], detections: TableDetections, t: FloatArray) -> Tracklet:
    if len(tracklets) == 1:
        return tracklets[0]
    frame_index = np.concatenate([tracklet.frame_index for tracklet in tracklets])
    row = np.concatenate([tracklet.row for tracklet in tracklets])
    new = frame_index > np.maximum.accumulate(np.concatenate([[-1], frame_index[:-1]]))
    return make_tracklet(frame_index[new], row[new], detections, t)


def _link_cost(before: Tracklet, after: Tracklet, t: FloatArray, table: Table) -> float:
    """Evaluate the cost of `after` being the continuation of `before`: colour, and deviation from free motion."""
    gap = max(float(t[after.frame_index[0]] - t[before.frame_index[-1]]), 0.0)
    displacement = after.start[:2] - before.end[:2]
    distance = float(np.hypot(*displacement))
    if distance > MAX_SPEED * gap + table.ball_radius:
        return _IMPOSSIBLE
    rests = max(np.hypot(*before.end[2:]), np.hypot(*after.start[2:])) < REST_SPEED
    # struck and stopped within the gap: it cannot have gone farther than it can slow down
    if rests and distance > _reach_from_rest(gap, table.ball_radius):
        return _IMPOSSIBLE
    colour = float(((before.colour - after.colour) ** 2).sum()) / max(before.spread, after.spread) ** 2
    reach = 0.01 + 0.3 * gap + 0.5 * gap * float(np.hypot(*before.end[2:]))
    ahead = float(np.hypot(*(displacement - gap * (before.end[2:] + after.start[2:]) / 2)))
    motion = np.log1p((min(distance, ahead) / reach) ** 2) * 3.0
    limit = MAX_SAME_PLACE_COLOUR_COST if min(distance, ahead) < table.ball_radius else MAX_COLOUR_COST
    return float(
        min(colour / 2, limit) + motion + 2.0 * np.log1p(gap) + (15.0 if ends_in_pocket(before, table) else 0.0)
    )


def drop_unconfirmed_departures(
    tracklets: list[Tracklet], detections: TableDetections, t: FloatArray, table: Table
) -> list[Tracklet]:
    """Drop the last detections of balls that rest until then, where too few show that it is the ball that left.

    A hand that passes over a resting ball hides it and is detected instead. A ball that falls into a pocket is excused.
    """
    confirmed = []
    for one in tracklets:
        xy = detections.xy[one.row]
        jumps = np.flatnonzero(np.hypot(*np.diff(xy, axis=0).T) > 2 * table.ball_radius) + 1
        last = [k for k in jumps if len(xy) - k < MIN_DETECTIONS <= k]
        if last and not ends_in_pocket(one, table):
            k = last[0]
            if np.ptp(xy[k - MIN_DETECTIONS : k], axis=0).max() < table.ball_radius / 2:
                one = make_tracklet(one.frame_index[:k], one.row[:k], detections, t)
        confirmed.append(one)
    return confirmed


def ends_in_pocket(tracklet: Tracklet, table: Table) -> bool:
    """Return whether a tracklet ends near a pocket and moves towards it."""
    if not table.pockets:
        return False
    towards = table.pocket_centres - tracklet.end[:2]
    gap = np.hypot(*towards.T)
    nearest = int(np.argmin(gap))
    speed = float(np.hypot(*tracklet.end[2:]))
    heading = float(tracklet.end[2:] @ towards[nearest]) / max(speed * float(gap[nearest]), 1e-9)
    return bool(gap[nearest] < 3 * table.ball_radius + 0.1 * speed and speed > 0.05 and heading > 0.3)
