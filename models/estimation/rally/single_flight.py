"""One flight fitted alone to places in the image, with what is known before: the building block of the search.

The fit starts from the linear problem that is left once drag and lift are held (the projection of a place times its
depth is linear in place and velocity at the start), and ends with damped least squares over all parameters. Its
Laplace evidence lets flights of different numbers be compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from models.core.constants import GRAVITY
from models.core.court import Sport
from models.core.rally import FLIGHT_PARAMETERS
from models.core.typing import FloatArray
from models.estimation.rally.flight_observations import (
    CLUTTER_COST,
    ROBUST_SCALE,
    FlightObservations,
    bound_residuals,
    compare_places,
    weigh_by_law,
)
from models.numerics.least_squares import (
    SearchOptions,
    invert_semidefinite,
    measure_log_determinant,
    minimize_residuals,
)
from models.physics.flight.flight_motion import PARAMETER_COUNT, FlightPath, fly

# Where parameters of the law stand among those of a flight.
DRAG, TURN_DRAG, DRAG_EXPONENT, LAG_LIFT = (
    FLIGHT_PARAMETERS.index(name) for name in ("drag", "turn_drag", "drag_exponent", "lag_lift")
)
LIFT = tuple(FLIGHT_PARAMETERS.index(name) for name in ("lift_x", "lift_y", "lift_z"))
# m beyond the ends, and beside the sides, that a flight alone may begin at; a broad prior, as its height and speed.
_HEIGHT = (1.5, 2.0)
# Share of the largest speed that is the standard deviation of each component of the velocity.
_SPEED_SHARE = 0.3
# Least standard deviation of a parameter of the law: one that a sport does not have, or that is known, stays put.
_NONE = 1e-5
# m, softness of the floor, through which nothing flies.
_FLOOR_SOFTNESS = 0.05
# Share by which the drag of one flight departs from that of the clip: the drag coefficient varies with speed and spin.
DRAG_SPREAD = 0.04
# Spread of the places of a flight, as a multiple of that before anything was seen, from which it is none: usually it is
# 1 to 2, but 10^6 and more where small changes of the law turn a path anywhere.
_LOST = 100.0
# Initial speeds with which the linear problem is solved, as shares of the largest; the best of them starts the search.
_START_SPEEDS = (0.05, 0.15, 0.3, 0.5, 0.8)
# Standard deviations from which residuals pull less in the first search: a start is far from what it should explain.
_FAR_SCALE = 30.0
_FIRST_SEARCH = SearchOptions(iterations=10, attempts=5, min_relative_gain=0.05, min_gain=1.0, damping=1e-2)
_SEARCH = SearchOptions(iterations=15, attempts=5, min_gain=0.1, min_relative_gain=1e-3, quiet_steps=2)


@dataclass(frozen=True, slots=True)
class FlightPrior:
    """What is known of the parameters of a flight before it is seen."""

    mean: FloatArray
    """(P,)"""
    sigma: FloatArray
    """(P,)"""


@dataclass(frozen=True, slots=True)
class Pin:
    """A place through which a flight is believed to pass."""

    t: float
    """s."""
    place: FloatArray
    """(3,) m."""
    sigma: FloatArray
    """(3,) m."""


@dataclass(frozen=True, slots=True)
class SingleFlight:
    """A flight that was fitted alone. Its parameters refer to its first observation."""

    parameters: FloatArray
    """(P,)"""
    covariance: FloatArray
    """(P, P)"""
    cost: float
    """Robust chi2, the prior's included."""
    evidence: float
    """Natural logarithm of the probability density of the observations (Laplace), per standard deviation of each."""
    path: FlightPath
    """At the times of the observations."""
    turns: bool
    """Whether it begins with a hit, after which a shuttle turns over."""


def build_flight_prior(sport: Sport) -> FlightPrior:
    """Build the prior of a flight of a sport: anywhere in the surroundings of the court, at any speed."""
    item = sport.object
    behind, beside = sport.surroundings
    mean = np.zeros(PARAMETER_COUNT)
    mean[:3] = sport.length / 2, sport.width / 2, _HEIGHT[0]
    mean[DRAG], mean[TURN_DRAG], mean[DRAG_EXPONENT] = item.drag.mean, item.turn_drag.mean, item.drag_exponent.mean
    sigma = np.empty(PARAMETER_COUNT)
    sigma[:3] = sport.length / 3 + behind / 2, sport.width / 3 + beside / 2, _HEIGHT[1]
    sigma[3:6] = _SPEED_SHARE * item.max_speed * np.array([1.0, 0.5, 0.5])
    sigma[DRAG] = np.hypot(item.drag.sigma, DRAG_SPREAD * item.drag.mean)
    sigma[list(LIFT)] = max(item.lift, _NONE)
    sigma[TURN_DRAG] = max(item.turn_drag.sigma, _NONE)
    sigma[DRAG_EXPONENT] = max(item.drag_exponent.sigma, _NONE)
    sigma[LAG_LIFT] = max(item.lag_lift, _NONE)
    return FlightPrior(mean, sigma)


def fit_single_flight(
    observed: FlightObservations,
    sport: Sport,
    prior: FlightPrior,
    turns: bool = True,
    heading: float = 0.0,
    pins: tuple[Pin, ...] = (),
) -> SingleFlight | None:
    """Fit a flight to observations that it alone explains.

    Args:
        observed: N >= 2 observations.
        prior: Prior of its parameters.
        turns: Whether it begins with a hit, after which a shuttle turns over.
        heading: Sign of the speed along the court with which the search starts; 0 for either.
        pins: Places through which the flight passes.

    Returns:
        The flight; None where the search finds no possible one, or nothing holds its parameters or its places.
    """
    turn_length = sport.object.turn_length if turns else 0.0
    tau = observed.t - observed.t[0]
    start = _solve_linear(observed, tau, prior, turn_length, heading, pins)
    pin_times = np.array([pin.t for pin in pins]) - observed.t[0]

    def evaluate(
        p: FloatArray, scale: float = ROBUST_SCALE, most: float = CLUTTER_COST
    ) -> tuple[FloatArray, FloatArray] | None:
        path = fly(p, tau, turn_length)
        if not np.isfinite(path.states).all():
            return None
        residual, by_place = compare_places(observed, path.states[:, :3])
        weight = weigh_by_law(by_place, path.states[:, :3], sport.object)
        residual, by_place = residual * weight[:, None], by_place * weight[:, None, None]
        factor, slope = bound_residuals(residual, scale, observed.bound_clutter(most))
        below = np.minimum(path.states[:, 2] - sport.object.radius - sport.floor, 0.0) / _FLOOR_SOFTNESS
        rows = np.concatenate([(residual * factor[:, None]).ravel(), (p - prior.mean) / prior.sigma, below])
        by_parameters = (by_place @ path.derivatives[:, :3]) * slope[:, None, None]
        by_below = np.where(below < 0, 1 / _FLOOR_SOFTNESS, 0.0)[:, None] * path.derivatives[:, 2]
        by = np.vstack([by_parameters.reshape(-1, PARAMETER_COUNT), np.diag(1 / prior.sigma), by_below])
        if pins:
            pinned = fly(p, pin_times, turn_length)
            if not np.isfinite(pinned.states).all():
                return None
            for pin, state, slopes in zip(pins, pinned.states, pinned.derivatives, strict=True):
                rows = np.append(rows, (state[:3] - pin.place) / pin.sigma)
                by = np.vstack([by, slopes[:3] / pin.sigma[:, None]])
        return rows, by

    best = None
    for scale, most in ((_FAR_SCALE, np.inf), (ROBUST_SCALE, np.inf), (ROBUST_SCALE, CLUTTER_COST)):
        try:
            best = minimize_residuals(
                start if best is None else best.point,
                partial(evaluate, scale=scale, most=most),
                _SEARCH if best else _FIRST_SEARCH,
            )
        except ValueError:
            return None
    assert best is not None
    rows = evaluate(best.point)
    if rows is None:
        return None
    information = rows[1].T @ rows[1]
    log_determinant = measure_log_determinant(rows[1] * prior.sigma)
    if not np.isfinite(log_determinant):
        return None  # nothing holds one of its parameters
    evidence = -0.5 * best.cost - 0.5 * log_determinant
    path = fly(best.point, tau, turn_length)
    by_place = compare_places(observed, path.states[:, :3])[1]
    evidence += 2 * float(np.log(weigh_by_law(by_place, path.states[:, :3], sport.object)).sum())
    covariance = invert_semidefinite(information)
    spread = np.einsum("nip,pq,niq->ni", path.derivatives[:, :3], covariance, path.derivatives[:, :3])
    if not (spread < (_LOST * prior.sigma[:3]) ** 2).all():
        return None  # what is seen holds nothing of it, and its law is far from any that is known
    return SingleFlight(best.point, covariance, best.cost, evidence, path, turns)


def _solve_linear(
    observed: FlightObservations,
    tau: FloatArray,
    prior: FlightPrior,
    turn_length: float,
    heading: float,
    pins: tuple[Pin, ...],
) -> FloatArray:
    """Solve for place and velocity at the start, with the drag of several initial speeds; the best one starts a fit."""
    rows = observed.matrix[:, :2] - observed.px[:, :, None] * observed.matrix[:, 2:]  # (N, 2, 4)
    depth = np.maximum(observed.matrix[:, 2] @ np.append(prior.mean[:3], 1.0), 1.0)
    fastest = float(prior.sigma[3]) / _SPEED_SHARE
    best, least = prior.mean.copy(), np.inf
    for share in _START_SPEEDS:
        rate = prior.mean[DRAG] * (1 + prior.mean[TURN_DRAG] * (turn_length > 0) * 0.2) * share * fastest
        pin_tau = np.maximum(np.array([pin.t for pin in pins]) - observed.t[0], -0.2 / rate)
        # without gravity the speed falls as 1 / (1 + rate t); the fall is slowed at the same rate
        reach, fall = _slow_down(tau, rate)
        pin_reach, pin_fall = _slow_down(pin_tau, rate)
        now, p = depth, prior.mean.copy()
        mean, sigma = prior.mean[:6].copy(), prior.sigma[:6].copy()
        if heading:
            mean[3], sigma[3] = heading * share * fastest, 0.5 * share * fastest
        for _ in range(2):
            weighted = (observed.whitening @ rows) / now[:, None, None]
            by_place = weighted[:, :, :3]
            by = np.concatenate([by_place, by_place * reach[:, None, None]], axis=2).reshape(-1, 6)
            right = -(by_place[:, :, 2] * fall[:, None] + weighted[:, :, 3]).ravel()
            by = np.vstack([by, np.diag(1 / sigma)])
            extra = [mean / sigma]
            for pin, r, drop in zip(pins, pin_reach, pin_fall, strict=True):
                by = np.vstack([by, np.hstack([np.eye(3), r * np.eye(3)]) / pin.sigma[:, None]])
                extra.append((pin.place - [0.0, 0.0, drop]) / pin.sigma)
            p[:6] = np.linalg.lstsq(by, np.concatenate([right, *extra]), rcond=None)[0]
            xyz = p[:3] + p[3:6] * reach[:, None]
            now = np.maximum(np.einsum("nj,nj->n", observed.matrix[:, 2, :3], xyz) + observed.matrix[:, 2, 3], 1.0)
        path = fly(p, tau, turn_length).states[:, :3]
        if np.isfinite(path).all():
            residual = compare_places(observed, path)[0]
            cost = float((np.minimum(np.abs(residual), 1e3)).sum()) + float((((p[:6] - mean) / sigma) ** 2).sum())
            if cost < least:
                best, least = p.copy(), cost
    return best


def _slow_down(tau: FloatArray, rate: float) -> tuple[FloatArray, FloatArray]:
    """Return by how far a drag of a rate, 1/s, lets a unit speed get in times (N,), s, and how far gravity pulls, m."""
    slowed = np.log1p(rate * tau)
    return slowed / rate, -GRAVITY * (tau**2 / 4 + tau / (2 * rate) - slowed / (2 * rate**2))
