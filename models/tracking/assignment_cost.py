"""Assignment costs: how well motion and colour explain each detection of a new frame as each ball.

Costs are negative logarithms of likelihood ratios against "this detection is clutter".

Balls are predicted over one frame interval: straight on, off a cushion, or off each other. Tracking calls this once per
frame and hypothesis, so it is rough on purpose: no spin, one restitution for every contact, and a constant velocity
between contacts. The prediction variance covers the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.tracking.table_detections import TableDetections

# False detections per m^2 and frame.
CLUTTER_DENSITY = 0.15
# Probability that a ball is detected: in the open, and after it was missed for some frames.
DETECTION_PROBABILITY, HIDDEN_DETECTION_PROBABILITY = 0.95, 0.3
# m/s^2 per axis, one standard deviation: acceleration beyond rolling (sliding is about 2).
ACCELERATION_SIGMA = 1.5
# Probability per frame of a contact that was not predicted: in the open, and near balls and cushions.
UNPREDICTED_CONTACT_PROBABILITY, UNPREDICTED_CONTACT_PROBABILITY_NEAR = 0.002, 0.05
# Equally probable shares of the nearby speed that a contact gives a ball, and of the uncertainty of its place.
REACH_SHARES = (1.0, 0.3, 0.1, 0.03)
# m.
MIN_REACH = 0.002
# Probability per frame that something untracked sets a ball in motion; and that a new ball already moves.
STRIKE_PROBABILITY, NEW_BALL_STRIKE_PROBABILITY = 5e-4, 0.2
# m/s, typical of a struck ball; the tail reaches four times that.
STRIKE_SPEED = 3.0
# Share of detections that are displaced (by a hand, a shadow, a highlight), and the displacement in ball radii.
OUTLIER_PROBABILITY, OUTLIER_RADII = 0.01, 0.4
# Frame intervals: standard deviation of the time of a predicted contact.
CONTACT_TIME_SIGMA = 0.15
# Upper limit of the cost of a wrong colour: a hand, a shadow or a streak changes the colour.
MAX_COLOUR_COST = 12.0
# CIE Lab distance from the cloth below which a detection is a shadow or a projected line (balls keep 20 and more); and
# the cost of such a detection for a ball of another colour.
CLOTH_COLOUR_DISTANCE, CLOTH_COLOUR_COST = 12.0, 8.0
# Largest share of the cloth's colour in the mean colour of a streak.
MAX_CLOTH_SHARE = 0.6
# Frames with a detection from which a ball is confirmed; one that the next frames show at rest is so at birth.
CONFIRMED_HITS = 3
# Modes of a ball between two frames: free motion, a predicted contact, an unpredicted contact, a strike, or a displaced
# detection.
FREE, PREDICTED_CONTACT, UNPREDICTED_CONTACT, STRUCK, OUTLIER = range(5)
# Cost of a streak that is longer than the way the ball can have gone since the last frame; and its tolerance, ball
# radii.
LONG_STREAK_COST, STREAK_SLACK_RADII = 12.0, 1.0
# Upper limit of the cost of a motion against the push of the only ball nearby.
MAX_PULL_COST = 10.0


@dataclass(slots=True)
class TrackHypothesis:
    """One assignment history of all frames so far: N balls, their states, their detections in the last frame."""

    label: IntArray
    """(N,)"""
    xy: FloatArray
    v: FloatArray
    p: FloatArray
    """(N, 3) variances per axis: place, covariance of place and velocity, velocity."""
    colour: FloatArray
    colour_sigma: FloatArray
    """(N, 3) and (N,): mean colour, L*a*b*, and its standard deviation."""
    hit_count: IntArray
    miss_count: IntArray
    """(N,) frames with a detection (`CONFIRMED_HITS` at birth for a ball at rest), and frames since the last one."""
    last_detection: IntArray
    """(N,) detection in the last frame, -1 for none."""
    cost: float = 0.0
    parent: TrackHypothesis | None = field(default=None, repr=False)

    @property
    def is_confirmed(self) -> NDArray[np.bool_]:
        """(N,) balls with enough detections."""
        return self.hit_count >= CONFIRMED_HITS


@dataclass(frozen=True, slots=True)
class AssignmentCosts:
    """Costs of all detections for all balls of one hypothesis, and the predicted states."""

    cost: FloatArray
    """(N, K) negative log likelihood ratio against clutter."""
    missed_cost: FloatArray
    """(N,) cost of no detection."""
    mode: IntArray
    """(N, K) most probable mode of each assignment: `FREE`, ... `OUTLIER`."""
    nearby_speed: FloatArray
    """(N,) m/s, largest speed among the balls near each ball."""
    prediction: _MotionPrediction
    p_free: FloatArray
    p_contact: FloatArray
    """(N, 3)"""


def evaluate_assignment_costs(
    hypothesis: TrackHypothesis, detections: TableDetections, now: IntArray, dt: float, table: Table
) -> AssignmentCosts:
    """Evaluate the costs of the detections `now` (K,) for all balls of a hypothesis, `dt` s after its frame."""
    xy, v, p = hypothesis.xy, hypothesis.v, hypothesis.p
    speed = np.hypot(v[:, 0], v[:, 1])
    resting = (speed < 0.02) | (speed < 2 * np.sqrt(p[:, 2]))
    solid = hypothesis.is_confirmed & ((hypothesis.miss_count <= 3) | resting)
    prediction = predict_motion(
        xy, np.where(resting[:, None] & (hypothesis.hit_count > 3)[:, None], 0.0, v), dt, table, solid
    )
    acceleration = np.minimum(ACCELERATION_SIGMA, 0.02 + 20 * speed)
    p_free = _propagate_variances(p, dt, acceleration)
    velocity_sigma = _contact_velocity_sigma(prediction, p_free, table.ball_radius)
    # a velocity error since the contact becomes a place error by the time since then
    since = prediction.time_since_contact
    p_contact = p_free + np.stack(
        [velocity_sigma**2 * (since**2 + (CONTACT_TIME_SIGMA * dt) ** 2), velocity_sigma**2 * since, velocity_sigma**2],
        axis=1,
    )
    is_near, nearby_speed, push_from = _find_contact_opportunity(hypothesis, prediction, dt, table)

    z, s = detections.xy[now], detections.sigma[now]
    extra = detections.sigma_along[now] ** 2 - s**2
    along = unit_vectors(detections.streak[now])
    has_contact = prediction.contact_count > 0
    contact_probability = np.where(is_near, UNPREDICTED_CONTACT_PROBABILITY_NEAR, UNPREDICTED_CONTACT_PROBABILITY)
    midpoint = xy + v * dt / 2
    # balls push and never pull: a departure against the only possible push has another cause
    opposing = -((z[None] - prediction.free[:, None]) * push_from[:, None]).sum(axis=2) / (s[None] + 0.002)
    pull_cost = np.minimum(np.maximum(opposing, 0.0) ** 2 / 2, MAX_PULL_COST)
    outlier_variance = (OUTLIER_RADII * table.ball_radius) ** 2
    log_density = np.stack(
        [
            _log_spread(z, prediction.free, 0 * p_free[:, 0], np.sqrt(p_free[:, 0]), s, extra, along)
            + np.log(np.where(has_contact, 0.2, 0.95 - contact_probability))[:, None],
            _log_normal(z, prediction.xy, p_contact[:, 0], s, extra, along)
            + np.log(np.where(has_contact, 0.75, 1e-9))[:, None],
            _log_spread(z, midpoint, p[:, 0], 0.6 * nearby_speed * dt, s, extra, along)
            + np.log(contact_probability)[:, None]
            - pull_cost,
            _log_far(z, midpoint, (STRIKE_SPEED * dt / 2) ** 2)
            + np.log(np.where(hypothesis.hit_count == 1, NEW_BALL_STRIKE_PROBABILITY, STRIKE_PROBABILITY))[:, None],
            _log_normal(z, prediction.free, p_free[:, 0] + outlier_variance, s, extra, along)
            + np.log(OUTLIER_PROBABILITY),
        ]
    )  # (5, N, K)
    log_density -= LONG_STREAK_COST * _is_streak_too_long(hypothesis, detections, now, nearby_speed * dt, dt, table)
    mode = np.argmax(log_density, axis=0)
    detection_probability = _detection_probability(hypothesis, prediction, table)
    cost = (
        -log_density.max(axis=0)
        - np.log(detection_probability)[:, None]
        + np.log(CLUTTER_DENSITY)
        + _colour_cost(hypothesis, detections, now, table)
    )
    return AssignmentCosts(cost, -np.log(1 - detection_probability), mode, nearby_speed, prediction, p_free, p_contact)


def _is_streak_too_long(
    hypothesis: TrackHypothesis, detections: TableDetections, now: IntArray, reach: FloatArray, dt: float, table: Table
) -> FloatArray:
    """Mark (5, N, K) with 1 where a streak is too long for a ball in a mode.

    At the nearby speed a ball goes `reach` (N,) m. No exposure outlasts the frame interval. Only a strike by something
    untracked makes a ball faster than the balls nearby, and such a motion begins at the place of the ball.
    """
    length, slack = np.hypot(*detections.streak[now].T)[None], STREAK_SLACK_RADII * table.ball_radius
    furthest = (reach + 2 * np.sqrt(hypothesis.p[:, 2]) * dt + slack)[:, None]
    distance = np.hypot(*np.moveaxis(detections.xy[now][None] - hypothesis.xy[:, None], 2, 0))
    is_too_long = length > furthest
    return np.stack(
        [is_too_long, is_too_long, is_too_long, is_too_long & (length > 2 * distance + slack), is_too_long]
    ).astype(np.float64)


def _colour_cost(hypothesis: TrackHypothesis, detections: TableDetections, now: IntArray, table: Table) -> FloatArray:
    """Evaluate the cost (N, K) of colours.

    A streak mixes the ball's colour with the cloth's, and a cloth-like colour is no ball.
    """
    colour, cloth = detections.colour[now], detections.cloth
    difference = colour[None] - hypothesis.colour[:, None]
    fade = cloth - hypothesis.colour
    streaked = np.hypot(*detections.streak[now].T) > table.ball_radius
    share = (difference * fade[:, None]).sum(axis=2) / np.maximum((fade**2).sum(axis=1), 1e-9)[:, None]
    share = np.where(streaked, np.clip(share, 0.0, MAX_CLOTH_SHARE), 0.0)
    distance = ((difference - share[:, :, None] * fade[:, None]) ** 2).sum(axis=2) / hypothesis.colour_sigma[
        :, None
    ] ** 2
    is_cloth_like = np.hypot.reduce(colour - cloth, axis=1) < CLOTH_COLOUR_DISTANCE
    is_distinct = np.hypot.reduce(fade, axis=1) > 2 * CLOTH_COLOUR_DISTANCE
    cloth_cost = CLOTH_COLOUR_COST * (is_cloth_like & ~streaked)[None] * is_distinct[:, None]
    return np.asarray(np.minimum(distance / 2, MAX_COLOUR_COST) + cloth_cost)


def _propagate_variances(p: FloatArray, dt: float, acceleration: FloatArray) -> FloatArray:
    """Propagate variances (N, 3) over dt of free motion with a white acceleration `acceleration` (N,)."""
    place = p[:, 0] + 2 * dt * p[:, 1] + dt**2 * p[:, 2] + (acceleration * dt**2 / 2) ** 2
    return np.stack(
        [place, p[:, 1] + dt * p[:, 2] + acceleration**2 * dt**3 / 2, p[:, 2] + (acceleration * dt) ** 2], axis=1
    )


def _contact_velocity_sigma(prediction: _MotionPrediction, p: FloatArray, radius: float) -> FloatArray:
    """Estimate the standard deviation (N,) of the velocity after predicted contacts, m/s.

    An offset of a ball turns the line of centres.
    """
    tilt = np.clip(2 * np.sqrt(p[:, 0]) / radius, 0.12, 1.0)
    velocity_sigma: FloatArray = prediction.velocity_change * np.minimum(
        tilt * np.maximum(prediction.contact_count, 1), 1.0
    )
    return velocity_sigma


def _find_contact_opportunity(
    hypothesis: TrackHypothesis, prediction: _MotionPrediction, dt: float, table: Table
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Find which balls (N,) come near something that may change their velocity.

    Returns also the speeds (N,) nearby, m/s, and unit vectors (N, 2) from the one ball that could push each; 0 where
    several balls or a cushion could.
    """
    r = table.ball_radius
    a, b = hypothesis.xy, prediction.free
    speed = np.hypot(*(b - a).T) / max(dt, 1e-9)
    low, high = np.minimum(a, b), np.maximum(a, b)
    slack = 0.015 + 3 * np.sqrt(hypothesis.p[:, 0])
    rail = (
        (low.min(axis=1) < r + slack) | (high[:, 0] > table.length - r - slack) | (high[:, 1] > table.width - r - slack)
    )
    reach = (speed[:, None] + speed[None]) * dt / 2 + 2 * r + slack[:, None] + slack[None]
    middle = (a + b) / 2
    is_close = np.hypot(*np.moveaxis(middle[:, None] - middle[None], 2, 0)) < reach
    np.fill_diagonal(is_close, False)
    nearby_speed = np.maximum(speed, np.where(is_close, speed[None], 0.0).max(axis=1, initial=0.0))
    is_near = (rail & (speed > 0.02)) | (is_close.any(axis=1) & (nearby_speed > 0.02))
    other = np.argmax(is_close, axis=1) if len(a) else np.empty(0, np.int64)
    push_from = np.where(((is_close.sum(axis=1) == 1) & ~rail)[:, None], unit_vectors(a - a[other]), 0.0)
    return is_near, nearby_speed, push_from


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Normalize vectors (n, 2)."""
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    return vectors / np.maximum(length, 1e-9)[:, None]


def _log_normal(
    z: FloatArray, mean: FloatArray, variance: FloatArray, sigma: FloatArray, extra: FloatArray, along: FloatArray
) -> FloatArray:
    """Evaluate the log density (N, K) in 1/m^2 of detections z (K, 2) around places (N, 2), wider along the streak."""
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
    """Evaluate the log density (N, K) of detections around places known to within `reach` (N,) m, or much better.

    The velocities after a break spread over decades: each of `REACH_SHARES` of the reach is equally probable.
    """
    densities = [
        _log_normal(z, mean, variance + (share * reach + MIN_REACH) ** 2, sigma, extra, along) for share in REACH_SHARES
    ]
    mixed: FloatArray = np.logaddexp.reduce(densities, axis=0) - np.log(len(REACH_SHARES))
    return mixed


def _log_far(z: FloatArray, mean: FloatArray, variance: float) -> FloatArray:
    """Evaluate a log density (N, K) in 1/m^2 with a heavy tail."""
    r2 = ((z[None] - mean[:, None]) ** 2).sum(axis=2)
    density: FloatArray = -np.log(2 * np.pi * (variance + 1e-6)) - 1.5 * np.log1p(r2 / (variance + 1e-6))
    return density


def _detection_probability(hypothesis: TrackHypothesis, prediction: _MotionPrediction, table: Table) -> FloatArray:
    """Estimate the detection probability (N,); it is low in the jaws of a pocket and after missed detections."""
    probability = np.where(hypothesis.miss_count > 3, HIDDEN_DETECTION_PROBABILITY, DETECTION_PROBABILITY)
    probability = np.where(hypothesis.is_confirmed, probability, 0.5)
    if table.pockets:
        gap = np.hypot(*np.moveaxis(prediction.free[:, None] - table.pocket_centres[None], 2, 0)).min(axis=1)
        probability = np.where(gap < 3 * table.ball_radius, np.minimum(probability, 0.6), probability)
    return probability


# Ball against ball, 0.92 to 0.98 (Alciatore, TP A-6).
BALL_RESTITUTION = 0.95
# 0.75 to 0.98 by law and speed (Mathavan, Jackson, Parkin 2010).
CUSHION_RESTITUTION = 0.8
# m/s^2, of a ball that rolls freely.
ROLLING_DECELERATION = 0.15
# Per interval: a break has about 100; beyond, the balls are jammed and the rest of the interval is straight.
MAX_CONTACTS = 250
# Ball radii from a pocket's centre within which there is no cushion.
_JAW_RADII = 2.6


@dataclass(frozen=True, slots=True)
class _MotionPrediction:
    """Predicted states of N balls one frame interval later."""

    free: FloatArray
    """(N, 2) m, without any contact."""
    free_v: FloatArray
    """(N, 2) m/s."""
    xy: FloatArray
    """(N, 2) m, after contacts with cushions and balls."""
    v: FloatArray
    """(N, 2) m/s."""
    velocity_change: FloatArray
    """(N,) m/s, sum of the velocity changes; 0 without a contact."""
    contact_count: NDArray[np.int64]
    """(N,) number of contacts with cushions and balls."""
    time_since_contact: FloatArray
    """(N,) s from the contacts to the end of the interval, weighted by the velocity changes."""


def predict_motion(
    xy: FloatArray, v: FloatArray, dt: float, table: Table, solid: NDArray[np.bool_]
) -> _MotionPrediction:
    """Predict balls at xy (N, 2) m with v (N, 2) m/s over dt s; only `solid` (N,) ones collide with each other."""
    speed = np.hypot(v[:, 0], v[:, 1])
    speed_ratio = np.clip(1.0 - ROLLING_DECELERATION * dt / np.maximum(speed, 1e-9), 0.0, 1.0)[:, None]
    mean_v = v * (1.0 + speed_ratio) / 2
    free, free_v = xy + mean_v * dt, v * speed_ratio
    x, w = xy.copy(), mean_v.copy()
    velocity_change, time_since_contact, contact_count = np.zeros(len(x)), np.zeros(len(x)), np.zeros(len(x), np.int64)
    time_left = dt
    for _ in range(MAX_CONTACTS):
        pair_t, a, b = _next_ball_contact(x, w, table.ball_radius, solid, time_left)
        cushion_t, c, axis = _next_cushion_contact(x, w, table, time_left)
        step = min(pair_t, cushion_t, time_left)
        x += w * step
        time_left -= step
        if min(pair_t, cushion_t) > time_left + step or time_left + step <= 0:
            break
        if pair_t <= cushion_t:
            change = _collide_balls(x, w, a, b)
            velocity_change[[a, b]] += change
            time_since_contact[[a, b]] += change * time_left
            contact_count[[a, b]] += 1
        else:
            change = abs(w[c, axis]) * (1 + CUSHION_RESTITUTION)
            velocity_change[c] += change
            time_since_contact[c] += change * time_left
            w[c, axis] *= -CUSHION_RESTITUTION
            contact_count[c] += 1
    else:
        x += w * time_left
    has_contact = (contact_count > 0)[:, None]
    time_since_contact = time_since_contact / np.maximum(velocity_change, 1e-12)
    return _MotionPrediction(
        free,
        free_v,
        np.where(has_contact, x, free),
        np.where(has_contact, w, free_v),
        velocity_change,
        contact_count,
        time_since_contact,
    )


def _next_ball_contact(
    x: FloatArray, v: FloatArray, radius: float, solid: NDArray[np.bool_], horizon: float
) -> tuple[float, int, int]:
    """Find the time to the next contact of two balls, and which; infinite if there is none before the horizon."""
    moving = np.flatnonzero(solid & ((v != 0).any(axis=1)))
    others = np.flatnonzero(solid)
    if not len(moving) or len(others) < 2:
        return np.inf, 0, 0
    d = x[others][None] - x[moving][:, None]  # (M, S, 2)
    u = v[others][None] - v[moving][:, None]
    du = (d * u).sum(axis=2)
    uu = (u * u).sum(axis=2)
    excess = np.maximum((d * d).sum(axis=2) - 4 * radius**2, 0.0)
    root = du**2 - uu * excess
    hit = (du < -1e-9) & (root >= 0) & (moving[:, None] != others[None])
    if not hit.any():
        return np.inf, 0, 0
    time = np.where(hit, excess / np.where(hit, -du + np.sqrt(np.maximum(root, 0)), 1.0), np.inf)
    best = int(np.argmin(time))
    first = float(time.flat[best])
    i, j = divmod(best, len(others))
    return (first if first <= horizon else np.inf), int(moving[i]), int(others[j])


def _next_cushion_contact(x: FloatArray, v: FloatArray, table: Table, horizon: float) -> tuple[float, int, int]:
    """Find the time to the next cushion contact, the ball and the axis; infinite if there is none."""
    r = table.ball_radius
    low, high = np.full(2, r), np.array([table.length - r, table.width - r])
    wall = np.where(v > 0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(v != 0, np.maximum((wall - x) / v, 0.0), np.inf)  # (N, 2)
    time[np.isnan(time)] = np.inf
    if table.pockets and np.any(time <= horizon):
        for ball, axis in np.argwhere(time <= horizon):
            place = x[ball] + v[ball] * time[ball, axis]
            if np.min(np.hypot(*(table.pocket_centres - place).T)) < _JAW_RADII * r:
                time[ball, axis] = np.inf
    best = int(np.argmin(time)) if time.size else 0
    first = float(time.flat[best]) if time.size else np.inf
    ball, axis = divmod(best, 2)
    return (first if first <= horizon else np.inf), ball, axis


def _collide_balls(x: FloatArray, v: FloatArray, a: int, b: int) -> float:
    """Exchange the velocity of two equal masses along their line of centres; return the change of either, m/s."""
    normal = x[b] - x[a]
    normal = normal / max(float(np.hypot(*normal)), 1e-12)
    change = (1 + BALL_RESTITUTION) / 2 * float((v[a] - v[b]) @ normal)
    v[a] -= change * normal
    v[b] += change * normal
    return abs(change)
