"""Which detection is which ball, decided late: several readings of the last pictures are followed side by side.

Every reading (`Reading`) holds all balls with a place and a velocity. For each new picture it foresees where its balls
go (straight on, or through contacts with cushions and each other), prices every detection for every ball, takes the
cheapest assignment and the cheapest exchanges of two balls beside it. Readings that explain the following pictures
badly die out; after `patience` seconds the best one decides (Reid 1979, doi:10.1109/TAC.1979.1102177; the branching
is over exchanges instead of Murty's full ranking).

Costs are negative logarithms of likelihood ratios against "this detection is clutter".
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from models.foresight import Foresight, foresee
from models.progress import Progress, silent
from models.scene import Table
from models.sightings import Sightings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLUTTER = 0.15
"""1/m^2 and picture: false detections."""
SEEN, SEEN_HIDDEN = 0.95, 0.3
"""Chance that a ball is detected: in the open, and where it went unseen lately."""
PUSH = 1.5
"""m/s^2, standard deviation per axis of what free motion does beyond rolling (sliding is about 2)."""
NEW_BALL_SPEED = 0.1
"""m/s, standard deviation per axis of the velocity of a ball that appears at rest, as most do."""
UNFORESEEN, UNFORESEEN_NEAR = 0.002, 0.05
"""Chance per picture of a contact that was not foreseen: in the open, and near balls and cushions."""
STRIKE, STRIKE_NEW = 5e-4, 0.2
"""Chance per picture of being set in motion by something that is not tracked; and that a new ball moves already."""
STRIKE_SPEED = 3.0
"""m/s, typical of a struck ball; the tail reaches four times that."""
OUTLIER, OUTLIER_RADII = 0.01, 0.4
"""Share of sightings that are off (a hand, a shadow, a highlight), and by how many ball radii."""
SUSPICIOUS = 5.0
"""Squared distance of a sighting in standard deviations, above which the velocity is doubted (8 % of good ones)."""
TIMING = 0.15
"""Standard deviation of the time of a foreseen contact, in picture intervals."""
LATE_BIRTH = 7.0
"""Price of a ball that appears after the first moments: balls do not, except from under a hand."""
COLOUR_LIMIT = 12.0
"""Most that a wrong colour may cost: a hand, a shadow or a streak changes it."""
STILL = 3
"""Sightings that a ball counts at birth where the next pictures show it at rest."""
FREE, MET, BUMPED, STRUCK, OFF = range(5)
"""A ball went on freely, through foreseen contacts, through unforeseen ones, was struck, or was badly measured."""
LATE_CONTACT = 0.3
"""Share of a foreseen velocity change by which the velocity is in doubt where the change was not seen."""
PULL = 10.0
"""Most that it may cost to be moved against the push of the only ball near."""
BRANCH_LIMIT = 14.0
"""How much dearer than the best an assignment may be to be followed."""
_IMPOSSIBLE = 1e6


@dataclass(slots=True)
class Reading:
    """One reading of all pictures so far: N balls and what they were assigned in the last picture."""

    label: Ints
    """(N,)"""
    xy: Floats
    v: Floats
    p: Floats
    """(N, 3) variances per axis: place, place with velocity, velocity."""
    colour: Floats
    spread: Floats
    """(N, 3) and (N,): mean L*a*b* and its standard deviation."""
    seen: Ints
    missed: Ints
    """(N,) pictures seen in all (`STILL` at birth for what is seen to rest), and missed since it was last seen."""
    last: Ints
    """(N,) detection in the last picture, -1 for none."""
    price: float = 0.0
    parent: Reading | None = field(default=None, repr=False)

    @property
    def sure(self) -> NDArray[np.bool_]:
        """(N,) balls that were seen often enough to be believed."""
        return self.seen >= 3


@dataclass(frozen=True, slots=True)
class Bid:
    """What every detection costs every ball of a reading, and the state it would start from."""

    cost: Floats
    """(N, K) against clutter."""
    miss: Floats
    """(N,)"""
    mode: Ints
    """(N, K) what explains it best: `FREE`, ... `OFF`."""
    pace: Floats
    """(N,) m/s, speeds at play near each ball."""
    foresight: Foresight
    p_free: Floats
    p_contact: Floats
    """(N, 3)"""


def follow(
    sightings: Sightings, t: Floats, table: Table, breadth: int, patience: float, progress: Progress = silent
) -> list[tuple[Ints, Ints]]:
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
    now: Ints,
    dt: float,
    early: bool,
    table: Table,
    breadth: int,
    labels: int,
) -> tuple[list[Reading], int]:
    """The best readings after one more picture, best first."""
    bids = [_bid(reading, sightings, now, dt, table) for reading in readings]
    choices: list[tuple[float, int, Ints]] = []
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


def _bid(reading: Reading, sightings: Sightings, now: Ints, dt: float, table: Table) -> Bid:
    """Price detections `now` (K,) for all balls."""
    xy, v, p = reading.xy, reading.v, reading.p
    speed = np.hypot(v[:, 0], v[:, 1])
    resting = (speed < 0.02) | (speed < 2 * np.sqrt(p[:, 2]))
    solid = reading.sure & ((reading.missed <= 3) | resting)
    foresight = foresee(xy, np.where(resting[:, None] & (reading.seen > 3)[:, None], 0.0, v), dt, table, solid)
    push = np.minimum(PUSH, 0.02 + 20 * speed)
    p_free = _propagate(p, dt, push)
    doubt = _contact_doubt(foresight, p_free, table.ball_radius)
    # a velocity that is off by `doubt` since the contact puts the ball off by as much times `since`
    since = foresight.since
    p_contact = p_free + np.stack([doubt**2 * (since**2 + (TIMING * dt) ** 2), doubt**2 * since, doubt**2], axis=1)
    near, pace, push_from = _opportunity(reading, foresight, dt, table)

    z, s = sightings.xy[now], sightings.sigma[now]
    extra = sightings.sigma_along[now] ** 2 - s**2
    along = _unit(sightings.streak[now])
    met = foresight.contacts > 0
    bump = np.where(near, UNFORESEEN_NEAR, UNFORESEEN)
    half = xy + v * dt / 2
    # balls push and never pull: what departs against the only possible push has not been pushed
    against = -((z[None] - foresight.free[:, None]) * push_from[:, None]).sum(axis=2) / (s[None] + 0.002)
    pull = np.minimum(np.maximum(against, 0.0) ** 2 / 2, PULL)
    wild = (OUTLIER_RADII * table.ball_radius) ** 2
    density = np.stack(
        [
            _log_normal(z, foresight.free, p_free[:, 0], s, extra, along)
            + np.log(np.where(met, 0.2, 0.95 - bump))[:, None],
            _log_normal(z, foresight.xy, p_contact[:, 0], s, extra, along) + np.log(np.where(met, 0.75, 1e-9))[:, None],
            _log_normal(z, half, p[:, 0] + (0.6 * pace * dt + 0.002) ** 2, s, extra, along)
            + np.log(bump)[:, None]
            - pull,
            _log_far(z, half, (STRIKE_SPEED * dt / 2) ** 2)
            + np.log(np.where(reading.seen == 1, STRIKE_NEW, STRIKE))[:, None],
            _log_normal(z, foresight.free, p_free[:, 0] + wild, s, extra, along) + np.log(OUTLIER),
        ]
    )  # (5, N, K)
    mode = np.argmax(density, axis=0)
    tint = ((sightings.colour[now][None] - reading.colour[:, None]) ** 2).sum(axis=2) / reading.spread[:, None] ** 2
    seen = _detection_chance(reading, foresight, table)
    cost = -density.max(axis=0) - np.log(seen)[:, None] + np.log(CLUTTER) + np.minimum(tint / 2, COLOUR_LIMIT)
    return Bid(cost, -np.log(1 - seen), mode, pace, foresight, p_free, p_contact)


def _propagate(p: Floats, dt: float, push: Floats) -> Floats:
    """Variances (N, 3) after dt of free motion with a white acceleration `push` (N,)."""
    place = p[:, 0] + 2 * dt * p[:, 1] + dt**2 * p[:, 2] + (push * dt**2 / 2) ** 2
    return np.stack([place, p[:, 1] + dt * p[:, 2] + push**2 * dt**3 / 2, p[:, 2] + (push * dt) ** 2], axis=1)


def _contact_doubt(foresight: Foresight, p: Floats, radius: float) -> Floats:
    """Standard deviation (N,) of the velocity after foreseen contacts, m/s: an offset turns the line of centres."""
    tilt = np.clip(2 * np.sqrt(p[:, 0]) / radius, 0.12, 1.0)
    doubt: Floats = foresight.kick * np.minimum(tilt * np.maximum(foresight.contacts, 1), 1.0)
    return doubt


def _opportunity(
    reading: Reading, foresight: Foresight, dt: float, table: Table
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Which balls (N,) come near something that may change their velocity, the speeds (N,) at play there, m/s, and
    the unit vectors (N, 2) from the one ball that could push them; 0 where that may be several, or a cushion."""
    r = table.ball_radius
    a, b = reading.xy, foresight.free
    speed = np.hypot(*(b - a).T) / max(dt, 1e-9)
    low, high = np.minimum(a, b), np.maximum(a, b)
    slack = 0.015 + 3 * np.sqrt(reading.p[:, 0])
    rail = (
        (low.min(axis=1) < r + slack) | (high[:, 0] > table.length - r - slack) | (high[:, 1] > table.width - r - slack)
    )
    reach = (speed[:, None] + speed[None]) * dt / 2 + 2 * r + slack[:, None] + slack[None]
    middle = (a + b) / 2
    close = np.hypot(*np.moveaxis(middle[:, None] - middle[None], 2, 0)) < reach
    np.fill_diagonal(close, False)
    pace = np.maximum(speed, np.where(close, speed[None], 0.0).max(axis=1, initial=0.0))
    near = (rail & (speed > 0.02)) | (close.any(axis=1) & (pace > 0.02))
    other = np.argmax(close, axis=1) if len(a) else np.empty(0, np.int64)
    push_from = np.where(((close.sum(axis=1) == 1) & ~rail)[:, None], _unit(a - a[other]), 0.0)
    return near, pace, push_from


def _unit(vectors: Floats) -> Floats:
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    return vectors / np.maximum(length, 1e-9)[:, None]


def _log_normal(z: Floats, mean: Floats, variance: Floats, sigma: Floats, extra: Floats, along: Floats) -> Floats:
    """Log density (N, K) in 1/m^2 of detections z (K, 2) around places (N, 2); a streak is less sure along itself."""
    r = z[None] - mean[:, None]
    across = variance[:, None] + sigma[None] ** 2
    lengthwise = across + extra[None]
    ahead = (r * along[None]).sum(axis=2) ** 2
    distance = ((r**2).sum(axis=2) - ahead) / across + ahead / lengthwise
    density: Floats = -distance / 2 - np.log(2 * np.pi) - np.log(across * lengthwise) / 2
    return density


def _log_far(z: Floats, mean: Floats, variance: float) -> Floats:
    """Log density (N, K) in 1/m^2 with a heavy tail."""
    r2 = ((z[None] - mean[:, None]) ** 2).sum(axis=2)
    density: Floats = -np.log(2 * np.pi * (variance + 1e-6)) - 1.5 * np.log1p(r2 / (variance + 1e-6))
    return density


def _detection_chance(reading: Reading, foresight: Foresight, table: Table) -> Floats:
    """Chance (N,) that a detector sees the ball; small in the jaws of a pocket and where it went unseen lately."""
    chance = np.where(reading.missed > 3, SEEN_HIDDEN, SEEN)
    chance = np.where(reading.sure, chance, 0.5)
    if table.pockets:
        gap = np.hypot(*np.moveaxis(foresight.free[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1)
        chance = np.where(gap < 3 * table.ball_radius, np.minimum(chance, 0.6), chance)
    return chance


def _assignments(reading: Reading, bid: Bid, breadth: int) -> list[tuple[float, Ints]]:
    """The cheapest assignment (N,) of detections (-1 for none), and the cheapest exchanges of two balls beside it."""
    n, k = bid.cost.shape
    if not n:
        return [(0.0, np.empty(0, np.int64))]
    full = np.full((n, k + n), _IMPOSSIBLE)
    full[:, :k] = np.minimum(bid.cost, _IMPOSSIBLE)
    full[np.arange(n), k + np.arange(n)] = bid.miss
    rows, columns = linear_sum_assignment(full)
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


def _departures(reading: Reading, bid: Bid, chosen: Ints, price: float) -> list[tuple[float, Ints]]:
    """Beside an assignment: a ball that was not seen left with a detection that nobody took, though that is rare."""
    unseen = np.flatnonzero((chosen < 0) & reading.sure & (reading.missed <= 3))
    free = np.setdiff1d(np.arange(bid.cost.shape[1]), chosen)
    if not len(unseen) or not len(free):
        return []
    delta = bid.cost[np.ix_(unseen, free)] - bid.miss[unseen, None]
    result = []
    for flat in np.argsort(delta, axis=None, kind="stable")[:2]:
        i, j = divmod(int(flat), len(free))
        if delta[i, j] < BRANCH_LIMIT:
            other = chosen.copy()
            other[unseen[i]] = free[j]
            result.append((price + float(delta[i, j]), other))
    return result


def _update(
    reading: Reading,
    bid: Bid,
    chosen: Ints,
    sightings: Sightings,
    now: Ints,
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
    start: Floats,
    xy: Floats,
    v: Floats,
    p: Floats,
    mode: int,
    sightings: Sightings,
    d: int,
    dt: float,
    radius: float,
    around: float,
) -> tuple[Floats, Floats, Floats]:
    """Place, velocity and variances of one ball after detection d; `around` is the speed at play near it, m/s."""
    z, r2 = sightings.xy[d], sightings.sigma[d] ** 2 + (mode == OFF) * (OUTLIER_RADII * radius) ** 2
    if mode in (BUMPED, STRUCK):
        pace = (z - start) / dt  # if it happened at the beginning of the interval; on average in its middle
        doubt = 0.7 * float(np.hypot(*pace)) + 0.2 + (mode == BUMPED) * 0.4 * around
        return z.copy(), 1.3 * pace, np.array([r2, 0.0, doubt**2])
    u = _unit(sightings.streak[d : d + 1])[0]
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


def _keep(reading: Reading, hit: NDArray[np.bool_], xy: Floats, table: Table) -> NDArray[np.bool_]:
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


def _births(chosen: Ints, sightings: Sightings, now: Ints, balls: Floats, table: Table) -> Ints:
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


def _walk_back(reading: Reading, pictures: int) -> list[tuple[Ints, Ints]]:
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
