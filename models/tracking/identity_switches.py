"""Correction of identity switches between balls that look alike, by their paths before and after a gap.

Switches in track folders under diagnosis are corrected in `diagnosis.diagnose`.

In a break, one frame interval holds several contacts of a ball, and no prediction reaches the next detection.
Afterwards the paths are known: one that comes straight from where a ball lay is that ball's, not its neighbour's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.core.typing import FloatArray
from models.tracking.table_detections import TableDetections
from models.tracking.tracklet_linking import Tracklet, make_tracklet

MAX_COLOUR_SIGMAS = 3.0
"""Standard deviations of colour by which confusable balls may differ."""
MIN_MISFIT_RADII = 1.0
"""Ball radii by which the paths before and after a gap miss each other, for a possible switch."""
MAX_REMAINING_SHARE = 0.5
"""Largest share of this misfit that remains after the switch is undone."""
MAX_VELOCITY_FRAMES = 3
"""Most frames between the detections that give a velocity."""
MAX_SWAPS = 20
"""Most corrected switches in one clip."""


class _TrackGap(NamedTuple):
    """The gap after detection `row` of a ball: place (2,) m, velocity (2,) m/s and time s on either side."""

    ball: int
    row: int
    x0: FloatArray
    v0: FloatArray
    t0: float
    x1: FloatArray
    v1: FloatArray
    t1: float


def correct_identity_switches(
    balls: list[Tracklet], detections: TableDetections, t: FloatArray, radius: float
) -> list[Tracklet]:
    """Swap what follows a gap between two balls where that makes their paths straighter by a ball's radius, m."""
    for _ in range(MAX_SWAPS):
        gaps = [gap for k, ball in enumerate(balls) for gap in _list_gaps(k, ball, detections, t)]
        suspicious = [gap for gap in gaps if _path_distance(gap, gap) > MIN_MISFIT_RADII * radius]
        candidates = [
            (gain, one, two)
            for one in suspicious
            for two in gaps
            if one.ball != two.ball
            and (gain := _swap_gain(one, two)) > MIN_MISFIT_RADII * radius
            and _have_similar_colour(balls, one.ball, two.ball)
        ]
        if not candidates:
            break
        _, one, two = max(candidates, key=lambda each: each[0])
        balls = _swap_after_gap(balls, one, two, detections, t)
    return balls


def _list_gaps(number: int, ball: Tracklet, detections: TableDetections, t: FloatArray) -> list[_TrackGap]:
    """List the gaps with two detections on either side, near enough in time to give velocities."""
    times, x = t[ball.frame_index], detections.xy[ball.row]
    v = np.diff(x, axis=0) / np.diff(times)[:, None]
    near = np.diff(ball.frame_index) <= MAX_VELOCITY_FRAMES
    return [
        _TrackGap(number, i, x[i], v[i - 1], float(times[i]), x[i + 1], v[i + 1], float(times[i + 1]))
        for i in range(1, len(times) - 2)
        if near[i - 1] and near[i + 1]
    ]


def _path_distance(one: _TrackGap, two: _TrackGap) -> float:
    """Return the distance by which the path into a gap misses the path out of another, m.

    The ball may turn once between them.
    """
    lasts = two.t1 - one.t0
    apart, turn = one.x0 - two.x1 + lasts * two.v1, one.v0 - two.v1
    s = float(np.clip(-(apart @ turn) / max(float(turn @ turn), 1e-12), 0.0, lasts))
    return float(np.hypot(*(apart + s * turn)))


def _swap_gain(one: _TrackGap, two: _TrackGap) -> float:
    """Return the misfit that a swap of two balls removes, m; 0 where they cannot have been switched."""
    if not (one.t0 < two.t1 and two.t0 < one.t1):
        return 0.0
    straight, swapped = (
        _path_distance(one, one) + _path_distance(two, two),
        _path_distance(one, two) + _path_distance(two, one),
    )
    return straight - swapped if swapped < MAX_REMAINING_SHARE * straight else 0.0


def _have_similar_colour(balls: list[Tracklet], i: int, j: int) -> bool:
    difference = float(np.hypot.reduce(balls[i].colour - balls[j].colour))
    return difference < MAX_COLOUR_SIGMAS * float(np.hypot(balls[i].spread, balls[j].spread))


def _swap_after_gap(
    balls: list[Tracklet], one: _TrackGap, two: _TrackGap, detections: TableDetections, t: FloatArray
) -> list[Tracklet]:
    """Give each ball the other's detections after its gap."""
    swapped = list(balls)
    for mine, other in ((one, two), (two, one)):
        head, tail = balls[mine.ball], balls[other.ball]
        frame_index, row = (
            np.concatenate([before[: mine.row + 1], after[other.row + 1 :]])
            for before, after in ((head.frame_index, tail.frame_index), (head.row, tail.row))
        )
        swapped[mine.ball] = make_tracklet(frame_index, row, detections, t)
    return swapped
