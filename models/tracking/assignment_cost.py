"""What every detection of a new picture costs every ball: how well physics and colour explain it.

Costs are negative logarithms of likelihood ratios against "this detection is clutter".
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.tracking.motion_prediction import Foresight, foresee
from models.tracking.table_detections import Sightings

CLUTTER = 0.15
"""1/m^2 and picture: false detections."""
SEEN, SEEN_HIDDEN = 0.95, 0.3
"""Chance that a ball is detected: in the open, and where it went unseen lately."""
PUSH = 1.5
"""m/s^2, standard deviation per axis of what free motion does beyond rolling (sliding is about 2)."""
UNFORESEEN, UNFORESEEN_NEAR = 0.002, 0.05
"""Chance per picture of a contact that was not foreseen: in the open, and near balls and cushions."""
SHARES = (1.0, 0.3, 0.1, 0.03)
"""of the speed at play that a contact may give a ball, and of what is not known of a ball's place."""
LEAST_REACH = 0.002
"""m"""
STRIKE, STRIKE_NEW = 5e-4, 0.2
"""Chance per picture of being set in motion by something that is not tracked; and that a new ball moves already."""
STRIKE_SPEED = 3.0
"""m/s, typical of a struck ball; the tail reaches four times that."""
OUTLIER, OUTLIER_RADII = 0.01, 0.4
"""Share of sightings that are off (a hand, a shadow, a highlight), and by how many ball radii."""
TIMING = 0.15
"""Standard deviation of the time of a foreseen contact, in picture intervals."""
COLOUR_LIMIT = 12.0
"""Most that a wrong colour may cost: a hand, a shadow or a streak changes it."""
CLOTH_LIKE, GHOST = 12.0, 8.0
"""CIE Lab distance from the cloth below which a shadow or a projected line is meant, balls keep 20 and more; and what
such a sighting costs a ball of another colour."""
MOST_CLOTH = 0.6
"""Share of the cloth's colour in the mean colour of a streak, at most."""
STILL = 3
"""Sightings that a ball counts at birth where the next pictures show it at rest."""
FREE, MET, BUMPED, STRUCK, OFF = range(5)
"""A ball went on freely, through foreseen contacts, through unforeseen ones, was struck, or was badly measured."""
HURRY, HURRY_SLACK_RADII = 12.0, 1.0
"""What a streak costs that is longer than the ball can have gone since the last picture; and radii that it may be."""
PULL = 10.0
"""Most that it may cost to be moved against the push of the only ball near."""


@dataclass(slots=True)
class Reading:
    """One reading of all pictures so far: N balls and what they were assigned in the last picture."""

    label: IntArray
    """(N,)"""
    xy: FloatArray
    v: FloatArray
    p: FloatArray
    """(N, 3) variances per axis: place, place with velocity, velocity."""
    colour: FloatArray
    spread: FloatArray
    """(N, 3) and (N,): mean L*a*b* and its standard deviation."""
    seen: IntArray
    missed: IntArray
    """(N,) pictures seen in all (`STILL` at birth for what is seen to rest), and missed since it was last seen."""
    last: IntArray
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

    cost: FloatArray
    """(N, K) against clutter."""
    miss: FloatArray
    """(N,)"""
    mode: IntArray
    """(N, K) what explains it best: `FREE`, ... `OFF`."""
    pace: FloatArray
    """(N,) m/s, speeds at play near each ball."""
    foresight: Foresight
    p_free: FloatArray
    p_contact: FloatArray
    """(N, 3)"""


def make_bid(reading: Reading, sightings: Sightings, now: IntArray, dt: float, table: Table) -> Bid:
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
    along = unit(sightings.streak[now])
    met = foresight.contacts > 0
    bump = np.where(near, UNFORESEEN_NEAR, UNFORESEEN)
    half = xy + v * dt / 2
    # balls push and never pull: what departs against the only possible push has not been pushed
    against = -((z[None] - foresight.free[:, None]) * push_from[:, None]).sum(axis=2) / (s[None] + 0.002)
    pull = np.minimum(np.maximum(against, 0.0) ** 2 / 2, PULL)
    wild = (OUTLIER_RADII * table.ball_radius) ** 2
    density = np.stack(
        [
            _log_spread(z, foresight.free, 0 * p_free[:, 0], np.sqrt(p_free[:, 0]), s, extra, along)
            + np.log(np.where(met, 0.2, 0.95 - bump))[:, None],
            _log_normal(z, foresight.xy, p_contact[:, 0], s, extra, along) + np.log(np.where(met, 0.75, 1e-9))[:, None],
            _log_spread(z, half, p[:, 0], 0.6 * pace * dt, s, extra, along) + np.log(bump)[:, None] - pull,
            _log_far(z, half, (STRIKE_SPEED * dt / 2) ** 2)
            + np.log(np.where(reading.seen == 1, STRIKE_NEW, STRIKE))[:, None],
            _log_normal(z, foresight.free, p_free[:, 0] + wild, s, extra, along) + np.log(OUTLIER),
        ]
    )  # (5, N, K)
    density -= HURRY * _hurried(reading, sightings, now, pace * dt, dt, table)
    mode = np.argmax(density, axis=0)
    seen = _detection_chance(reading, foresight, table)
    cost = -density.max(axis=0) - np.log(seen)[:, None] + np.log(CLUTTER) + _tint(reading, sightings, now, table)
    return Bid(cost, -np.log(1 - seen), mode, pace, foresight, p_free, p_contact)


def _hurried(
    reading: Reading, sightings: Sightings, now: IntArray, way: FloatArray, dt: float, table: Table
) -> FloatArray:
    """(5, N, K) 1 where a streak is too long for a ball in a mode; at play near it a ball goes `way` (N,) m.

    No shutter is open for longer than from picture to picture. Only a blow by something that is not tracked makes a
    ball faster than what plays near it, and that begins where the ball was.
    """
    length, slack = np.hypot(*sightings.streak[now].T)[None], HURRY_SLACK_RADII * table.ball_radius
    furthest = (way + 2 * np.sqrt(reading.p[:, 2]) * dt + slack)[:, None]
    gone = np.hypot(*np.moveaxis(sightings.xy[now][None] - reading.xy[:, None], 2, 0))
    known = length > furthest
    return np.stack([known, known, known, known & (length > 2 * gone + slack), known]).astype(np.float64)


def _tint(reading: Reading, sightings: Sightings, now: IntArray, table: Table) -> FloatArray:
    """Price (N, K) of colours: a streak mixes the ball's with the cloth's, and what looks like cloth is no ball's."""
    colour, cloth = sightings.colour[now], sightings.cloth
    off = colour[None] - reading.colour[:, None]
    fade = cloth - reading.colour
    streaked = np.hypot(*sightings.streak[now].T) > table.ball_radius
    share = (off * fade[:, None]).sum(axis=2) / np.maximum((fade**2).sum(axis=1), 1e-9)[:, None]
    share = np.where(streaked, np.clip(share, 0.0, MOST_CLOTH), 0.0)
    distance = ((off - share[:, :, None] * fade[:, None]) ** 2).sum(axis=2) / reading.spread[:, None] ** 2
    clothy = np.hypot.reduce(colour - cloth, axis=1) < CLOTH_LIKE
    plain = np.hypot.reduce(fade, axis=1) > 2 * CLOTH_LIKE
    ghost = GHOST * (clothy & ~streaked)[None] * plain[:, None]
    return np.asarray(np.minimum(distance / 2, COLOUR_LIMIT) + ghost)


def _propagate(p: FloatArray, dt: float, push: FloatArray) -> FloatArray:
    """Variances (N, 3) after dt of free motion with a white acceleration `push` (N,)."""
    place = p[:, 0] + 2 * dt * p[:, 1] + dt**2 * p[:, 2] + (push * dt**2 / 2) ** 2
    return np.stack([place, p[:, 1] + dt * p[:, 2] + push**2 * dt**3 / 2, p[:, 2] + (push * dt) ** 2], axis=1)


def _contact_doubt(foresight: Foresight, p: FloatArray, radius: float) -> FloatArray:
    """Standard deviation (N,) of the velocity after foreseen contacts, m/s: an offset turns the line of centres."""
    tilt = np.clip(2 * np.sqrt(p[:, 0]) / radius, 0.12, 1.0)
    doubt: FloatArray = foresight.kick * np.minimum(tilt * np.maximum(foresight.contacts, 1), 1.0)
    return doubt


def _opportunity(
    reading: Reading, foresight: Foresight, dt: float, table: Table
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
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
    push_from = np.where(((close.sum(axis=1) == 1) & ~rail)[:, None], unit(a - a[other]), 0.0)
    return near, pace, push_from


def unit(vectors: FloatArray) -> FloatArray:
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    return vectors / np.maximum(length, 1e-9)[:, None]


def _log_normal(
    z: FloatArray, mean: FloatArray, variance: FloatArray, sigma: FloatArray, extra: FloatArray, along: FloatArray
) -> FloatArray:
    """Log density (N, K) in 1/m^2 of detections z (K, 2) around places (N, 2); a streak is less sure along itself."""
    r = z[None] - mean[:, None]
    across = variance[:, None] + sigma[None] ** 2
    lengthwise = across + extra[None]
    ahead = (r * along[None]).sum(axis=2) ** 2
    distance = ((r**2).sum(axis=2) - ahead) / across + ahead / lengthwise
    density: FloatArray = -distance / 2 - np.log(2 * np.pi) - np.log(across * lengthwise) / 2
    return density


def _log_spread(
    z: FloatArray,
    mean: FloatArray,
    variance: FloatArray,
    reach: FloatArray,
    sigma: FloatArray,
    extra: FloatArray,
    along: FloatArray,
) -> FloatArray:
    """Log density (N, K) of detections around places that are known to within `reach` (N,) m, or much better.

    What a blow leaves for the balls of a rack spreads over decades: each of `SHARES` of the reach is as likely.
    """
    densities = [
        _log_normal(z, mean, variance + (share * reach + LEAST_REACH) ** 2, sigma, extra, along) for share in SHARES
    ]
    mixed: FloatArray = np.logaddexp.reduce(densities, axis=0) - np.log(len(SHARES))
    return mixed


def _log_far(z: FloatArray, mean: FloatArray, variance: float) -> FloatArray:
    """Log density (N, K) in 1/m^2 with a heavy tail."""
    r2 = ((z[None] - mean[:, None]) ** 2).sum(axis=2)
    density: FloatArray = -np.log(2 * np.pi * (variance + 1e-6)) - 1.5 * np.log1p(r2 / (variance + 1e-6))
    return density


def _detection_chance(reading: Reading, foresight: Foresight, table: Table) -> FloatArray:
    """Chance (N,) that a detector sees the ball; small in the jaws of a pocket and where it went unseen lately."""
    chance = np.where(reading.missed > 3, SEEN_HIDDEN, SEEN)
    chance = np.where(reading.sure, chance, 0.5)
    if table.pockets:
        gap = np.hypot(*np.moveaxis(foresight.free[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1)
        chance = np.where(gap < 3 * table.ball_radius, np.minimum(chance, 0.6), chance)
    return chance
