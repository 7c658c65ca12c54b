"""Balls that look alike and were exchanged in a burst of contacts: known by where their ways before and after it lead.

While a rack bursts, a picture holds several contacts of a ball, and no path foretells the next sighting. Afterwards the
ways are known: one that comes straight from where a ball lay is that ball's, not its neighbour's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.core.typing import FloatArray
from models.tracking.table_detections import Sightings
from models.tracking.tracklet_linking import Tracklet, make_tracklet

ALIKE = 3.0
"""standard deviations of colour by which balls may differ that can be taken for each other."""
BENT = 1.0
"""ball radii by which the ways before and after a gap miss each other, of a ball that may have been exchanged."""
SHARE = 0.5
"""Of what they miss, at most, once they are exchanged."""
SOON = 3
"""pictures between the sightings that tell a velocity, at most."""
MOST = 20
"""exchanges in one clip."""


class _Gap(NamedTuple):
    """Between two successive sightings of a ball, `row` and the next: place (2,) m, velocity (2,) m/s and time s on
    either side."""

    ball: int
    row: int
    x0: FloatArray
    v0: FloatArray
    t0: float
    x1: FloatArray
    v1: FloatArray
    t1: float


def uncrossed(balls: list[Tracklet], sightings: Sightings, t: FloatArray, radius: float) -> list[Tracklet]:
    """The balls, with what follows a gap exchanged where that leads two of them on straighter by a ball's radius, m."""
    for _ in range(MOST):
        gaps = [gap for k, ball in enumerate(balls) for gap in _gaps(k, ball, sightings, t)]
        bent = [gap for gap in gaps if _miss(gap, gap) > BENT * radius]
        found = [
            (gain, one, two)
            for one in bent
            for two in gaps
            if one.ball != two.ball and (gain := _gain(one, two)) > BENT * radius and _alike(balls, one.ball, two.ball)
        ]
        if not found:
            break
        _, one, two = max(found, key=lambda each: each[0])
        balls = _exchanged(balls, one, two, sightings, t)
    return balls


def _gaps(number: int, ball: Tracklet, sightings: Sightings, t: FloatArray) -> list[_Gap]:
    """Between sightings with two on either side near enough to tell velocities."""
    times, x = t[ball.picture], sightings.xy[ball.row]
    v = np.diff(x, axis=0) / np.diff(times)[:, None]
    near = np.diff(ball.picture) <= SOON
    return [
        _Gap(number, i, x[i], v[i - 1], float(times[i]), x[i + 1], v[i + 1], float(times[i + 1]))
        for i in range(1, len(times) - 2)
        if near[i - 1] and near[i + 1]
    ]


def _miss(one: _Gap, two: _Gap) -> float:
    """By how much the way to a gap misses the way from another one, m, if the ball turned once between them."""
    lasts = two.t1 - one.t0
    apart, turn = one.x0 - two.x1 + lasts * two.v1, one.v0 - two.v1
    s = float(np.clip(-(apart @ turn) / max(float(turn @ turn), 1e-12), 0.0, lasts))
    return float(np.hypot(*(apart + s * turn)))


def _gain(one: _Gap, two: _Gap) -> float:
    """By how much less two balls miss their ways once exchanged, m; 0 where they cannot have been."""
    if not (one.t0 < two.t1 and two.t0 < one.t1):
        return 0.0
    straight, crossed = _miss(one, one) + _miss(two, two), _miss(one, two) + _miss(two, one)
    return straight - crossed if crossed < SHARE * straight else 0.0


def _alike(balls: list[Tracklet], i: int, j: int) -> bool:
    off = float(np.hypot.reduce(balls[i].colour - balls[j].colour))
    return off < ALIKE * float(np.hypot(balls[i].spread, balls[j].spread))


def _exchanged(balls: list[Tracklet], one: _Gap, two: _Gap, sightings: Sightings, t: FloatArray) -> list[Tracklet]:
    """The balls, each with the other's sightings after its gap."""
    fresh = list(balls)
    for mine, other in ((one, two), (two, one)):
        head, tail = balls[mine.ball], balls[other.ball]
        picture, row = (
            np.concatenate([before[: mine.row + 1], after[other.row + 1 :]])
            for before, after in ((head.picture, tail.picture), (head.row, tail.row))
        )
        fresh[mine.ball] = make_tracklet(picture, row, sightings, t)
    return fresh
