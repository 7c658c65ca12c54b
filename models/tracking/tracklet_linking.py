"""Tracklets to balls: which one goes on where another ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.numerics.assignment import assigned
from models.tracking.table_detections import Sightings

FASTEST = 12.0
"""m/s, a hard break."""
LONG_GAP, FEWEST = 4, 3
"""Pictures without a sighting that end a tracklet, and the fewest sightings of one."""
OVERLAP = 3
"""Pictures in which a ball at rest may be seen twice, as one tracklet of it ends and the other begins."""
LINK_PRICE = 30.0
"""Cost above which two tracklets are two balls; balls do not appear, so it is high."""
COLOUR_LIMIT, SAME_PLACE_COLOUR = 25.0, 5.0
"""Most that different colours may cost: little where one ball could only be the other, as a hand shades them."""
_IMPOSSIBLE = 1e6


@dataclass(frozen=True, slots=True)
class Tracklet:
    """M sightings of one ball."""

    picture: IntArray
    row: IntArray
    """(M,) row in `Sightings`."""
    colour: FloatArray
    """(3,) median."""
    spread: float
    """of the colour, one standard deviation."""
    start: FloatArray
    end: FloatArray
    """(4,) x, y, vx, vy at the first and at the last sighting."""


def cut(chains: list[tuple[IntArray, IntArray]], sightings: Sightings, t: FloatArray) -> list[Tracklet]:
    """Tracklets of chains of (pictures, sightings), cut at long gaps: a ball that left may have picked up clutter."""
    tracklets = []
    for picture, row in chains:
        starts = np.flatnonzero(np.diff(picture, prepend=-LONG_GAP - 1) > LONG_GAP)
        for first, end in zip(starts, [*starts[1:], len(picture)], strict=True):
            if end - first >= FEWEST:
                tracklets.append(make_tracklet(picture[first:end], row[first:end], sightings, t))
    return tracklets


def make_tracklet(picture: IntArray, row: IntArray, sightings: Sightings, t: FloatArray) -> Tracklet:
    """Gather what stitching needs of a chain of sightings."""
    colours = sightings.colour[row]
    middle = np.median(colours, axis=0)
    spread = float(np.clip(1.4826 * np.median(np.abs(colours - middle)), 3.0, 20.0))
    xy, times = sightings.xy[row], t[picture]
    return Tracklet(picture, row, middle, spread, _state(xy[:4], times[:4], 0), _state(xy[-4:], times[-4:], -1))


def _state(xy: FloatArray, t: FloatArray, at: int) -> FloatArray:
    """Place and velocity (4,) at one end of a few samples."""
    if len(t) < 2:
        return np.concatenate([xy[at], np.zeros(2)])
    tau = t - t[at]
    slope, place = np.polynomial.polynomial.polyfit(tau, xy, 1)[::-1]
    return np.concatenate([place, slope])


def stitch(tracklets: list[Tracklet], sightings: Sightings, t: FloatArray, table: Table) -> list[Tracklet]:
    """Join tracklets over gaps, cheapest together."""
    pieces, n = tracklets, len(tracklets)
    if not n:
        return []
    cost = np.full((n, 2 * n), _IMPOSSIBLE)
    cost[:, n:] = LINK_PRICE / 2
    for i, before in enumerate(pieces):
        for j, after in enumerate(pieces):
            if _follows(before, after, table):
                cost[i, j] = _link_cost(before, after, t, table) - LINK_PRICE / 2
    rows, columns = assigned(cost)
    follower = {int(i): int(j) for i, j in zip(rows, columns, strict=True) if j < n and cost[i, j] < LINK_PRICE / 2}
    heads = sorted(set(range(n)) - set(follower.values()))
    return [_join([pieces[i] for i in _chain(head, follower)], sightings, t) for head in heads]


def _follows(before: Tracklet, after: Tracklet, table: Table) -> bool:
    """Whether one tracklet begins where the other has ended, or within the last moments of a ball in one place."""
    overlap = int(before.picture[-1]) - int(after.picture[0])
    if overlap < 0:
        return True
    later = before.picture[0] < after.picture[0] and before.picture[-1] < after.picture[-1]
    apart = float(np.hypot(*(after.start[:2] - before.end[:2])))
    return bool(later and overlap < OVERLAP and apart < table.ball_radius)


def _chain(head: int, follower: dict[int, int]) -> list[int]:
    chain = [head]
    while chain[-1] in follower:
        chain.append(follower[chain[-1]])
    return chain


def _join(pieces: list[Tracklet], sightings: Sightings, t: FloatArray) -> Tracklet:
    if len(pieces) == 1:
        return pieces[0]
    picture = np.concatenate([piece.picture for piece in pieces])
    row = np.concatenate([piece.row for piece in pieces])
    new = picture > np.maximum.accumulate(np.concatenate([[-1], picture[:-1]]))
    return make_tracklet(picture[new], row[new], sightings, t)


def _link_cost(before: Tracklet, after: Tracklet, t: FloatArray, table: Table) -> float:
    """Price of `after` being `before` seen again: colour, and how far physics must be stretched."""
    gap = max(float(t[after.picture[0]] - t[before.picture[-1]]), 0.0)
    way = after.start[:2] - before.end[:2]
    distance = float(np.hypot(*way))
    if distance > FASTEST * gap + table.ball_radius:
        return _IMPOSSIBLE
    colour = float(((before.colour - after.colour) ** 2).sum()) / max(before.spread, after.spread) ** 2
    reach = 0.01 + 0.3 * gap + 0.5 * gap * float(np.hypot(*before.end[2:]))
    ahead = float(np.hypot(*(way - gap * (before.end[2:] + after.start[2:]) / 2)))
    motion = np.log1p((min(distance, ahead) / reach) ** 2) * 3.0
    limit = SAME_PLACE_COLOUR if min(distance, ahead) < table.ball_radius else COLOUR_LIMIT
    return float(min(colour / 2, limit) + motion + 2.0 * np.log1p(gap) + (15.0 if fell(before, table) else 0.0))


def fell(piece: Tracklet, table: Table) -> bool:
    """Whether a tracklet ends in a pocket: near one, and moving towards it."""
    if not table.pockets:
        return False
    towards = table.pocket_centres - piece.end[:2]
    gap = np.hypot(*towards.T)
    nearest = int(np.argmin(gap))
    speed = float(np.hypot(*piece.end[2:]))
    heading = float(piece.end[2:] @ towards[nearest]) / max(speed * float(gap[nearest]), 1e-9)
    return bool(gap[nearest] < 3 * table.ball_radius + 0.1 * speed and speed > 0.05 and heading > 0.3)
