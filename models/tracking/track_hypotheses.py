"""Which detection is which ball, decided late: several readings of the last pictures are followed side by side.

Every reading (`Reading`) holds all balls with a place and a velocity. For each new picture it foresees where its balls
go (straight on, or through contacts with cushions and each other), prices every detection for every ball, takes the
cheapest assignment and the cheapest exchanges of two balls beside it. Readings that explain the following pictures
badly die out; after `patience` seconds the best one decides (Reid 1979, doi:10.1109/TAC.1979.1102177; the branching
is over exchanges instead of Murty's full ranking).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from models.core.progress import Progress, silent
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.numerics.assignment import assigned
from models.tracking.assignment_cost import (
    BUMPED,
    FREE,
    MET,
    OFF,
    OUTLIER_RADII,
    STILL,
    STRUCK,
    Bid,
    Reading,
    make_bid,
    unit,
)
from models.tracking.table_detections import Sightings

NEW_BALL_SPEED = 0.1
"""m/s, standard deviation per axis of the velocity of a ball that appears at rest, as most do."""
SUSPICIOUS = 5.0
"""Squared distance of a sighting in standard deviations, above which the velocity is doubted (8 % of good ones)."""
LATE_BIRTH = 7.0
"""Price of a ball that appears after the first moments: balls do not, except from under a hand."""
LATE_CONTACT = 0.3
"""Share of a foreseen velocity change by which the velocity is in doubt where the change was not seen."""
BRANCH_LIMIT = 14.0
"""How much dearer than the best an assignment may be to be followed."""
_IMPOSSIBLE = 1e6


def follow(
    sightings: Sightings, t: FloatArray, table: Table, breadth: int, patience: float, progress: Progress = silent
) -> list[tuple[IntArray, IntArray]]:
    """Tracklets as (pictures (M,), detections (M,)), in the order of their birth."""
    readings = [_nothing()]
    labels = 0
    window = max(3, round(patience / float(np.median(np.diff(t)))))
    for k in range(len(t)):
        now = np.arange(sightings.first[k], sightings.first[k + 1])
        dt = float(t[k] - t[k - 1]) if k else 0.0
        early = float(t[k] - t[0]) < 0.4
        readings, labels = _advance(readings, sightings, now, dt, early, table, breadth, labels)
        readings = _decide(readings, window)
        progress((k + 1) / len(t))
    return _walk_back(readings[0], len(t))


def _nothing() -> Reading:
    none = np.empty(0, np.int64)
    return Reading(
        none, np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), none, none, none
    )


def _advance(
    readings: list[Reading],
    sightings: Sightings,
    now: IntArray,
    dt: float,
    early: bool,
    table: Table,
    breadth: int,
    labels: int,
) -> tuple[list[Reading], int]:
    """The best readings after one more picture, best first."""
    bids = [make_bid(reading, sightings, now, dt, table) for reading in readings]
    choices: list[tuple[float, int, IntArray]] = []
    for index, (reading, bid) in enumerate(zip(readings, bids, strict=True)):
        for price, chosen in _assignments(reading, bid, breadth):
            choices.append((reading.price + price, index, chosen))
    choices.sort(key=lambda choice: choice[:2])
    limit = choices[0][0] + 25.0
    after = []
    for price, index, chosen in choices[:breadth]:
        if price <= limit:
            child = _update(readings[index], bids[index], chosen, sightings, now, dt, early, table, labels)
            child.price += price
            after.append(child)
    after.sort(key=lambda reading: reading.price)
    return after, max([labels] + [int(r.label.max()) + 1 for r in after if len(r.label)])


def _assignments(reading: Reading, bid: Bid, breadth: int) -> list[tuple[float, IntArray]]:
    """The cheapest assignment (N,) of detections (-1 for none), and the cheapest exchanges of two balls beside it."""
    n, k = bid.cost.shape
    if not n:
        return [(0.0, np.empty(0, np.int64))]
    full = np.full((n, k + n), _IMPOSSIBLE)
    full[:, :k] = np.minimum(bid.cost, _IMPOSSIBLE)
    full[np.arange(n), k + np.arange(n)] = bid.miss
    rows, columns = assigned(full)
    chosen = np.where(columns < k, columns, -1)
    price = float(full[rows, columns].sum())
    result = [(price, chosen)]
    if breadth > 1:
        result += _departures(reading, bid, chosen, price)
    seen = np.flatnonzero((chosen >= 0) & reading.sure)
    if breadth > 1 and len(seen) > 1:
        swap = bid.cost[np.ix_(seen, chosen[seen])]
        own = np.diag(swap)
        delta = swap + swap.T - own[:, None] - own[None]
        delta[np.tril_indices(len(seen))] = np.inf
        for flat in np.argsort(delta, axis=None, kind="stable")[:4]:
            i, j = divmod(int(flat), len(seen))
            if delta[i, j] > BRANCH_LIMIT:
                break
            other = chosen.copy()
            other[seen[i]], other[seen[j]] = chosen[seen[j]], chosen[seen[i]]
            result.append((price + float(delta[i, j]), other))
    return result


def _departures(reading: Reading, bid: Bid, chosen: IntArray, price: float) -> list[tuple[float, IntArray]]:
    """Beside an assignment: a ball that was not seen left with a detection that nobody took, though that is rare.

    Two may have: a ball that was struck behind a hand, and the one that it sent off before it was seen again.
    """
    unseen = np.flatnonzero((chosen < 0) & reading.sure & (reading.missed <= 3))
    free = np.setdiff1d(np.arange(bid.cost.shape[1]), chosen)
    if not len(unseen) or not len(free):
        return []
    delta = bid.cost[np.ix_(unseen, free)] - bid.miss[unseen, None]
    ways = [divmod(int(flat), len(free)) for flat in np.argsort(delta, axis=None, kind="stable")[:4]]
    ways = [way for way in ways if delta[way] < BRANCH_LIMIT]
    pairs = [(p, q) for p, q in combinations(ways, 2) if p[0] != q[0] and p[1] != q[1]]
    result = []
    for departed in [*((way,) for way in ways[:2]), *pairs[:1]]:
        other = chosen.copy()
        for i, j in departed:
            other[unseen[i]] = free[j]
        result.append((price + float(sum(delta[way] for way in departed)), other))
    return result


def _update(
    reading: Reading,
    bid: Bid,
    chosen: IntArray,
    sightings: Sightings,
    now: IntArray,
    dt: float,
    early: bool,
    table: Table,
    labels: int,
) -> Reading:
    """The reading one picture later."""
    hit = chosen >= 0
    rows = np.arange(len(chosen))
    mode = np.where(
        hit, bid.mode[rows, chosen] if bid.mode.shape[1] else FREE, np.where(bid.foresight.contacts > 0, MET, FREE)
    )
    contact = mode == MET
    xy = np.where(contact[:, None], bid.foresight.xy, bid.foresight.free)
    v = np.where(contact[:, None], bid.foresight.v, bid.foresight.free_v)
    p = np.where(contact[:, None], bid.p_contact, bid.p_free)
    # seen as if a foreseen contact had not happened: it may only have come late, so the velocity stays in doubt
    p[:, 2] += np.where(mode == FREE, (LATE_CONTACT * bid.foresight.kick) ** 2, 0.0)
    colour, spread = reading.colour.copy(), reading.spread.copy()
    for i in np.flatnonzero(hit):
        d = now[chosen[i]]
        xy[i], v[i], p[i] = _correct(
            reading.xy[i], xy[i], v[i], p[i], int(mode[i]), sightings, int(d), dt, table.ball_radius, float(bid.pace[i])
        )
        share = max(1 / (reading.seen[i] + 1), 0.05)
        colour[i] += share * (sightings.colour[d] - colour[i])
    keep = _keep(reading, hit, xy, table)
    born = _births(chosen, sightings, now, xy[hit], table)
    price = LATE_BIRTH * float(np.sum(hit & (reading.seen == 2)) + np.sum(sightings.still[born])) * (not early)
    z = sightings.xy[born]
    one = np.ones(len(born))
    speed = np.where(sightings.still[born], 0.01, NEW_BALL_SPEED)
    return Reading(
        np.concatenate([reading.label[keep], labels + np.arange(len(born))]),
        np.concatenate([xy[keep], z]),
        np.concatenate([v[keep], np.zeros_like(z)]),
        np.concatenate([p[keep], np.stack([sightings.sigma[born] ** 2, 0 * one, speed**2], axis=1)]),
        np.concatenate([colour[keep], sightings.colour[born]]),
        np.concatenate([spread[keep], 8.0 * one]),
        np.concatenate([(reading.seen + hit)[keep], np.where(sightings.still[born], STILL, 1)]),
        np.concatenate([np.where(hit, 0, reading.missed + 1)[keep], np.zeros(len(born), np.int64)]),
        np.concatenate([np.where(hit, now[chosen] if len(now) else -1, -1)[keep], born]),
        price,
        reading,
    )


def _correct(
    start: FloatArray,
    xy: FloatArray,
    v: FloatArray,
    p: FloatArray,
    mode: int,
    sightings: Sightings,
    d: int,
    dt: float,
    radius: float,
    around: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place, velocity and variances of one ball after detection d; `around` is the speed at play near it, m/s."""
    z, r2 = sightings.xy[d], sightings.sigma[d] ** 2 + (mode == OFF) * (OUTLIER_RADII * radius) ** 2
    if mode in (BUMPED, STRUCK):
        pace = (z - start) / dt  # if it happened at the beginning of the interval; on average in its middle
        doubt = 0.7 * float(np.hypot(*pace)) + 0.2 + (mode == BUMPED) * 0.4 * around
        return z.copy(), 1.3 * pace, np.array([r2, 0.0, doubt**2])
    u = unit(sightings.streak[d : d + 1])[0]
    innovation = z - xy
    ahead = float(innovation @ u) * u
    across = innovation - ahead
    total, total_along = p[0] + r2, p[0] + max(sightings.sigma_along[d] ** 2, r2)
    scaled = across / total + ahead / total_along
    gain = p[:2] / total
    corrected = np.array([p[0] * (1 - gain[0]), p[1] * (1 - gain[0]), p[2] - gain[1] * p[1]])
    corrected[0] = max(corrected[0], 0.02 * sightings.sigma[d] ** 2)
    # a ball that keeps departing from what was foreseen moves otherwise: doubt its velocity, to catch up with it
    distance = float(across @ across / (p[0] + sightings.sigma[d] ** 2))
    distance += float((innovation @ u) ** 2 / (p[0] + sightings.sigma_along[d] ** 2))
    if distance > SUSPICIOUS:
        corrected[2] += 0.1 * float(innovation @ innovation) / dt**2
        corrected[0] += 0.1 * float(innovation @ innovation)
    return xy + p[0] * scaled, v + p[1] * scaled, corrected


def _keep(reading: Reading, hit: NDArray[np.bool_], xy: FloatArray, table: Table) -> NDArray[np.bool_]:
    """Which balls stay in play: not those potted, run off, or never confirmed."""
    missed = np.where(hit, 0, reading.missed + 1)
    seen = reading.seen + hit
    speed = np.hypot(*reading.v.T)
    inside = (xy > 0).all(axis=1) & (xy[:, 0] < table.length) & (xy[:, 1] < table.width)
    patience = np.where(seen < 4, 2, np.where(speed > 0.05, 10, 10_000))
    if table.pockets and len(xy):
        gap = np.hypot(*np.moveaxis(xy[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1)
        patience = np.where((gap < 3 * table.ball_radius) & (speed > 0.05), np.minimum(patience, 4), patience)
    return (missed <= patience) & (inside | hit | (missed <= 2))


def _births(chosen: IntArray, sightings: Sightings, now: IntArray, balls: FloatArray, table: Table) -> IntArray:
    """Detections that nobody took and that lie on no ball just seen."""
    free = np.setdiff1d(np.arange(len(now)), chosen)
    if len(free) and len(balls):
        gap = np.hypot(*np.moveaxis(sightings.xy[now[free]][:, None] - balls[None], 2, 0)).min(axis=1)
        free = free[gap > 1.3 * table.ball_radius]
    return now[free]


def _decide(readings: list[Reading], window: int) -> list[Reading]:
    """Only readings that agree with the best one about what happened `window` pictures ago."""
    if len(readings) == 1:
        return readings
    roots = [_ancestor(reading, window) for reading in readings]
    return [reading for reading, root in zip(readings, roots, strict=True) if root is roots[0]]


def _ancestor(reading: Reading, generations: int) -> Reading:
    for _ in range(generations):
        if reading.parent is None:
            break
        reading = reading.parent
    return reading


def _walk_back(reading: Reading, pictures: int) -> list[tuple[IntArray, IntArray]]:
    found: dict[int, tuple[list[int], list[int]]] = {}
    node: Reading | None = reading
    k = pictures - 1
    while node is not None and k >= 0:
        for label, detection in zip(node.label.tolist(), node.last.tolist(), strict=True):
            if detection >= 0:
                times, rows = found.setdefault(label, ([], []))
                times.append(k)
                rows.append(detection)
        node, k = node.parent, k - 1
    return [(np.array(found[label][0][::-1]), np.array(found[label][1][::-1])) for label in sorted(found)]
