"""Evidence that two flights, each fitted alone, join in a hit, a bounce or the net.

Both flights are Gaussian in their place and velocity at the moment between them. An event states what must hold there
(one place; at a bounce the height and the change of velocity) within its own spread; the evidence is the density of
that statement, integrated over the unknown time, over the prior density of what it makes redundant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.court import Range, Sport
from models.core.rally import RallyEventKind
from models.core.typing import FloatArray
from models.estimation.rally.play_order import locate_event
from models.estimation.rally.single_flight import FlightPrior

# Hits per second of play, and share of passages over the net that touch it: from rallies of professionals.
HIT_RATE, NET_SHARE = 0.8, 0.02
# m by which a racket displaces the object while it touches it, and by which one moves during a bounce.
CONTACT_SPREAD = 0.02
# m/s by which spin and unevenness change a bounce, beyond the ranges of restitution and retention.
BOUNCE_SPREAD = (0.8, 0.3)
# m, softness of the players' reach, and of the edges of the surroundings.
REACH_SOFTNESS, SURROUNDINGS_SOFTNESS = 0.25, 1.0
# m/s by which the velocity after a touch of the net is uncertain for a slow object, and which the net itself may give.
NET_SPREAD = 0.5
# Shares of the velocity that the net leaves, and by how much of the speed they are uncertain: its tape turns the object
# up, down and back, below it nothing gets through. Where nothing pushes, friction takes anything from none to all.
_TAPE, _BELOW, _SLIDE_ALONG = (0.15, 0.25), (0.0, 0.1), (0.5, 0.29)
# m from the edge of the net down to which the tape reaches.
_TAPE_WIDTH = 0.05
# m, depth of the net as an obstacle: its tape gives way.
NET_DEPTH = 0.08
# Shares of the reach outside of which the density of hits, 6 u (1 - u) at a share u, falls no further: a racket seldom
# gets to the floor, and seldom as high as a jump.
HIT_HEIGHTS = (0.01, 0.98)
# Probability that a hit sends the object away from the net, and that it sends it on the way it came: mishits.
_MISHIT = 0.02
# chi2 up to which an improbable state of a flight counts: an absurd one must not gain by being explained.
_LARGEST_SURPRISE = 9.0
_KINDS: tuple[RallyEventKind, ...] = ("hit", "bounce", "landing", "net")
# Shares of the speed that a shuttle keeps where it lands, across and along the floor: it hops and slides a little.
_HOP, _SLIDE = Range(0.2, 0.15), Range(0.4, 0.25)


@dataclass(frozen=True, slots=True)
class FlightEnds:
    """States of A flights at one of their ends."""

    t: float
    """s, of the observation at this end."""
    state: FloatArray
    """(A, 6)"""
    covariance: FloatArray
    """(A, 6, 6)"""
    acceleration: FloatArray
    """(A, 3) m/s^2."""


@dataclass(frozen=True, slots=True)
class _Joint:
    """The states of all pairs of flights at a moment, (A * B, ...)."""

    p_a: FloatArray
    p_b: FloatArray
    v_a: FloatArray
    v_b: FloatArray
    cov_a: FloatArray
    cov_b: FloatArray


def weigh_events(
    before: FlightEnds, after: FlightEnds, sport: Sport, prior: FlightPrior
) -> dict[RallyEventKind, tuple[FloatArray, FloatArray, FloatArray]]:
    """Weigh the kinds of events by which flights may follow each other.

    Args:
        before: A flights at their last observations.
        after: B flights at their first observations.
        prior: Prior of a flight.

    Returns:
        Natural logarithm (A, B) of the evidence of each kind, the time (A, B) of the event, s, and where (A, B, 3) it
        is, see `locate_event`.
    """
    outcome: dict[RallyEventKind, tuple[FloatArray, FloatArray, FloatArray]] = {}
    shape = len(before.state), len(after.state)
    for kind in _KINDS:
        if kind in ("bounce", "landing") and (kind == "bounce") == (sport.object.restitution is None):
            continue
        heights = (0.0,) if kind != "bounce" or sport.floor == 0 else (0.0, sport.floor)
        best = np.full(shape[0] * shape[1], -np.inf)
        when, where = np.full(len(best), np.nan), np.zeros((len(best), 3))
        for height in heights:
            value, t, place = _weigh_kind(kind, before, after, sport, prior, height)
            better = value > best
            best, when = np.where(better, value, best), np.where(better, t, when)
            where = np.where(better[:, None], place, where)
        outcome[kind] = best.reshape(shape), when.reshape(shape), where.reshape(*shape, -1)
    return outcome


def limit_places(sport: Sport) -> tuple[tuple[float, float, float], ...]:
    """Return the least and largest x and y, m, of play, z at which players hit, and the softness of these limits."""
    behind, beside = sport.surroundings
    return (
        (-behind, sport.length + behind, SURROUNDINGS_SOFTNESS),
        (-beside, sport.width + beside, SURROUNDINGS_SOFTNESS),
        (sport.floor + sport.object.radius, sport.floor + sport.reach, REACH_SOFTNESS),
    )


def name_contact(sport: Sport) -> RallyEventKind:
    """Name what happens where the object meets the ground."""
    return "landing" if sport.object.restitution is None else "bounce"


def turns_over(kind: RallyEventKind | None) -> bool:
    """Check whether a shuttle turns over after an event: its nose does not point where it flies then."""
    return kind not in ("bounce", "landing")


def leave_net(velocity: FloatArray, place: FloatArray, sport: Sport) -> tuple[FloatArray, FloatArray]:
    """Return the shares (n, 3) of velocities (n, 3) that the net leaves at places (n, 3), and the errors of them.

    Returns:
        Shares, and the standard deviations (n, 3) of the velocities after the touch, m/s.
    """
    edge = sport.net.height_at(place[:, 1], sport.width) - sport.object.radius - _TAPE_WIDTH
    is_below, speed = (place[:, 2] < edge)[:, None], np.linalg.norm(velocity, axis=1)[:, None]
    tape, below, along = _TAPE, _BELOW, _SLIDE_ALONG
    left = np.where(is_below, [below[0], along[0], along[0]], [tape[0], along[0], tape[0]])
    by_speed = np.where(is_below, [below[1], 0.0, 0.0], [tape[1], 0.0, tape[1]]) * speed
    by_slide = np.where(is_below, [0.0, along[1], along[1]], [0.0, along[1], 0.0]) * np.abs(velocity)
    return left, np.sqrt(by_speed**2 + by_slide**2 + NET_SPREAD**2)


def contact_ranges(sport: Sport) -> tuple[Range, Range]:
    """Return the restitution and the retention of a contact with the ground; a shuttle hops and slides a little."""
    item = sport.object
    return (_HOP, _SLIDE) if item.restitution is None or item.retention is None else (item.restitution, item.retention)


def _weigh_kind(
    kind: RallyEventKind, before: FlightEnds, after: FlightEnds, sport: Sport, prior: FlightPrior, height: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    count = len(before.state) * len(after.state)
    slack = 0.25 * (after.t - before.t)
    t = np.full(count, (before.t + after.t) / 2)
    for _ in range(3):
        joint = _move_states(before, after, t)
        gap, rate, spread = _state_constraint(kind, joint, sport, height)
        inverse = np.linalg.inv(spread)
        information = np.maximum(np.einsum("ni,nij,nj->n", rate, inverse, rate), 1e-12)
        wanted = t - np.einsum("ni,nij,nj->n", rate, inverse, gap) / information
        t = np.clip(wanted, before.t - slack, after.t + slack)
    joint = _move_states(before, after, t)
    gap, rate, spread = _state_constraint(kind, joint, sport, height)
    square = np.einsum("ni,nij,nj->n", gap, np.linalg.inv(spread), gap)
    size = gap.shape[1]
    width = np.minimum(np.sqrt(2 * np.pi / information), after.t - before.t + 2 * slack)
    value = -0.5 * square - 0.5 * np.linalg.slogdet(spread)[1] - 0.5 * size * np.log(2 * np.pi) + np.log(width)
    replaced = slice(0, 3) if kind == "hit" else slice(0, 6)
    value -= np.tile(
        _log_normal(after.state[:, replaced], prior.mean[replaced], prior.sigma[replaced]), len(before.state)
    )
    gain = joint.cov_a[:, :3, :3] @ np.linalg.inv(spread[:, :3, :3])
    place = joint.p_a - np.einsum("nij,nj->ni", gain, gap[:, :3])
    deviation = np.sqrt(np.maximum(np.einsum("nii->ni", joint.cov_a[:, :3, :3] - gain @ joint.cov_a[:, :3, :3]), 1e-6))
    for axis, (low, high, softness) in enumerate(limit_places(sport)[:2]):
        value -= 0.5 * _excess(place[:, axis], low, high) ** 2 / (deviation[:, axis] ** 2 + softness**2)
    if kind == "hit":
        value += np.log(HIT_RATE) + _weigh_hit(place, deviation, joint, sport)
    elif kind in ("bounce", "landing"):
        value += np.log(np.maximum(-joint.v_a[:, 2], 0.05))
        inside = _excess(place[:, 0], -0.02, sport.length + 0.02) ** 2 / (deviation[:, 0] ** 2 + 0.02**2)
        inside += _excess(place[:, 1], -0.02, sport.width + 0.02) ** 2 / (deviation[:, 1] ** 2 + 0.02**2)
        if sport.floor < 0 and height == 0:
            value -= 0.5 * inside
    else:
        value += np.log(NET_SHARE) + np.log(np.maximum(np.abs(joint.v_a[:, 0]), 0.05))
        edge = sport.net.height_at(place[:, 1], sport.width)
        over = np.maximum(place[:, 2] - edge - sport.object.radius, 0.0)
        value -= 0.5 * over**2 / (deviation[:, 2] ** 2 + 0.03**2)
        (slow, variance), (fast, other) = _find_speed(joint.v_a, joint.cov_a), _find_speed(joint.v_b, joint.cov_b)
        value -= 0.5 * np.maximum(fast - slow, 0.0) ** 2 / (variance + other + NET_SPREAD**2)
    return value, t, locate_event(place[:, 0], deviation[:, 0], np.full(count, height < 0), sport)


def _move_states(before: FlightEnds, after: FlightEnds, t: FloatArray) -> _Joint:
    count_a, count_b = len(before.state), len(after.state)
    a, b = np.repeat(np.arange(count_a), count_b), np.tile(np.arange(count_b), count_a)
    parts = []
    for ends, rows in ((before, a), (after, b)):
        s = (t - ends.t)[:, None]
        acceleration = ends.acceleration[rows]
        place = ends.state[rows, :3] + ends.state[rows, 3:] * s + 0.5 * acceleration * s**2
        velocity = ends.state[rows, 3:] + acceleration * s
        by = np.broadcast_to(np.eye(6), (len(rows), 6, 6)).copy()
        by[:, :3, 3:] = np.eye(3) * s[:, :, None]
        covariance = by @ ends.covariance[rows] @ by.transpose(0, 2, 1)
        # the acceleration changes over a gap in which the object was hidden
        lost = (0.1 * np.linalg.norm(acceleration, axis=1) * s[:, 0] ** 2) ** 2
        covariance[:, :3, :3] += np.eye(3) * lost[:, None, None]
        parts.append((place, velocity, covariance))
    (p_a, v_a, cov_a), (p_b, v_b, cov_b) = parts
    return _Joint(p_a, p_b, v_a, v_b, cov_a, cov_b)


def _state_constraint(
    kind: RallyEventKind, joint: _Joint, sport: Sport, height: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """State what must be 0 (n, C), its rate (n, C) with time, and its covariance (n, C, C)."""
    n = len(joint.p_a)
    gap, rate = joint.p_a - joint.p_b, joint.v_a - joint.v_b
    spread = np.broadcast_to(np.eye(3) * CONTACT_SPREAD**2, (n, 3, 3))
    to_a, to_b = np.zeros((n, 7, 6)), np.zeros((n, 7, 6))
    to_a[:, :3, :3] = to_b[:, :3, :3] = np.eye(3)
    to_b *= -1.0
    if kind == "hit":
        by_a, by_b = to_a[:, :3], to_b[:, :3]
        return (
            gap,
            rate,
            by_a @ joint.cov_a @ by_a.transpose(0, 2, 1) + by_b @ joint.cov_b @ by_b.transpose(0, 2, 1) + spread,
        )
    item, extra = sport.object, np.zeros((n, 7, 7))
    extra[:, :3, :3] = spread
    to_b[:, 4:, 3:] = np.eye(3)
    more, more_rate = np.zeros((n, 4)), np.zeros((n, 4))
    if kind in ("bounce", "landing"):
        restitution, retention = contact_ranges(sport)
        left = np.array([retention.mean, retention.mean, -restitution.mean])
        to_b[:, 3, 2] = 1.0
        more[:, 0], more_rate[:, 0] = joint.p_b[:, 2] - height - item.radius, joint.v_b[:, 2]
        extra[:, 3, 3] = CONTACT_SPREAD**2
        level = joint.v_a[:, :2]
        extra[:, 4:6, 4:6] = retention.sigma**2 * level[:, :, None] * level[:, None, :]
        extra[:, [4, 5], [4, 5]] += BOUNCE_SPREAD[0] ** 2
        extra[:, 6, 6] = (restitution.sigma * joint.v_a[:, 2]) ** 2 + BOUNCE_SPREAD[1] ** 2
    else:
        left, off = leave_net(joint.v_a, joint.p_b, sport)
        to_b[:, 3, 0] = 1.0
        more[:, 0], more_rate[:, 0] = joint.p_b[:, 0] - sport.length / 2, joint.v_b[:, 0]
        extra[:, 3, 3] = NET_DEPTH**2
        extra[:, [4, 5, 6], [4, 5, 6]] = off**2
    to_a[:, [4, 5, 6], [3, 4, 5]] = -left
    more[:, 1:] = joint.v_b - left * joint.v_a
    spread = to_a @ joint.cov_a @ to_a.transpose(0, 2, 1) + to_b @ joint.cov_b @ to_b.transpose(0, 2, 1) + extra
    return np.hstack([gap, more]), np.hstack([rate, more_rate]), spread


def _weigh_hit(place: FloatArray, deviation: FloatArray, joint: _Joint, sport: Sport) -> FloatArray:
    """Weigh that players hit within their reach, and towards the net."""
    from scipy.special import ndtr

    low, high, softness = limit_places(sport)[2]
    off = _excess(place[:, 2], low, high) ** 2 / (deviation[:, 2] ** 2 + softness**2)
    share = np.clip((place[:, 2] - sport.floor) / sport.reach, *HIT_HEIGHTS)
    off -= 2 * np.log(6 * share * (1 - share))
    is_near = ndtr((sport.length / 2 - place[:, 0]) / deviation[:, 0])
    to_far = ndtr(joint.v_b[:, 0] / np.sqrt(joint.cov_b[:, 3, 3]))
    came_far = ndtr(joint.v_a[:, 0] / np.sqrt(joint.cov_a[:, 3, 3]))
    off -= 2 * (weigh_chance(is_near, to_far) + weigh_chance(came_far, 1 - to_far))
    return np.asarray(-0.5 * off)


def _find_speed(velocity: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the speed (n,), m/s, and its variance."""
    speed = np.linalg.norm(velocity, axis=1)
    way = velocity / np.maximum(speed, 1e-6)[:, None]
    return speed, np.einsum("ni,nij,nj->n", way, covariance[:, 3:, 3:], way)


def weigh_chance(one: FloatArray, other: FloatArray) -> FloatArray:
    """Weigh that two statements of given probabilities agree, as they do but for mishits."""
    return np.asarray(np.log(_MISHIT + (1 - _MISHIT) * (one * other + (1 - one) * (1 - other))))


def _excess(value: FloatArray, low: float, high: float) -> FloatArray:
    return np.asarray(np.maximum(value - high, 0.0) + np.maximum(low - value, 0.0))


def _log_normal(value: FloatArray, mean: FloatArray, sigma: FloatArray) -> FloatArray:
    return np.asarray(
        (
            -0.5 * np.minimum(((value - mean) / sigma) ** 2, _LARGEST_SURPRISE)
            - np.log(sigma)
            - 0.5 * np.log(2 * np.pi)
        ).sum(axis=-1)
    )
