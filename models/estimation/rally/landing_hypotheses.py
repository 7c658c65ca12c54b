"""Where the object first touches the ground after the last hit: seen, or continued by the physics of its flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from models.core.court import Sport
from models.core.rally import Flight, LandingHypothesis, RallyEvent
from models.core.typing import FloatArray
from models.estimation.rally.event_evidence import limit_places
from models.estimation.rally.rally_views import CONTACT_TIME, find_surface_contact
from models.physics.flight.flight_motion import fly

# 1/s by which a flight that is no longer seen ends otherwise: a hit, the net, or a player in the way.
_HAZARD = 1.0
# Frames before the ground within which the last observation must lie for the landing to count as seen.
_SEEN_FRAMES = 1.5
# Share of the drag by which the law of flight may err where nothing is seen of it.
_LAW_ERROR = 0.04
# Frames that add nothing to the risk: the object is missed in one or two of them anywhere.
_FREE_FRAMES = 2.0


def predict_landing(flight: Flight, sport: Sport, last_seen: float, interval: float) -> LandingHypothesis | None:
    """Continue a flight to the ground.

    Args:
        flight: The flight, with its whole covariance.
        last_seen: s, last observation of it.
        interval: s between frames.

    Returns:
        The landing with the probability that the flight gets there; None where it does not come down.
    """
    turn_length = sport.object.turn_length if flight.begins_with_hit else 0.0
    # a place that was fitted some millimetres below the surface has touched it just before
    after = max(last_seen - flight.start - CONTACT_TIME, 0.0)
    tau = find_surface_contact(flight.parameters, flight.begins_with_hit, sport, after)
    if not np.isfinite(tau):
        return None
    path = fly(flight.parameters, np.array([tau]), turn_length)
    place, velocity, by = path.states[0, :3], path.states[0, 3:], path.derivatives[0, :3]
    # the time at which the ground is reached changes with the height
    on_ground = by - velocity[:, None] / velocity[2] * by[2]
    gap = max(flight.start + tau - last_seen, 0.0)
    pull = flight.parameters[6] * float(velocity @ velocity)
    lost = 0.5 * _LAW_ERROR * pull * gap**2
    covariance = on_ground @ flight.covariance @ on_ground.T + np.diag([lost**2, lost**2, 0.0])
    time_variance = by[2] @ flight.covariance @ by[2] / velocity[2] ** 2
    weight = _weigh_gap(gap, interval)
    if gap > _SEEN_FRAMES * interval:
        weight *= _weigh_surroundings(place, covariance, sport)
    return LandingHypothesis(
        weight,
        float(flight.start + tau),
        float(np.sqrt(time_variance + (lost / max(abs(velocity[2]), 0.1)) ** 2)),
        place,
        covariance + np.diag([1e-8, 1e-8, 1e-8]),
        bool(gap <= _SEEN_FRAMES * interval),
    )


def find_landing(
    flights: tuple[Flight, ...], events: tuple[RallyEvent, ...], sport: Sport, last_seen: float, interval: float
) -> LandingHypothesis | None:
    """Find where the object first touches the ground after the last hit of one explanation.

    Args:
        events: Events, in the order of time.
        last_seen: s, last observation.
        interval: s between frames.

    Returns:
        The landing, its weight being the probability that it happens if the explanation is right.
    """
    hits = [k for k, event in enumerate(events) if event.kind == "hit"]
    touch = find_first_touch(events, hits[-1] if hits else -1, sport)
    if touch is not None:
        gap = max(touch.t - last_seen, 0.0)
        return LandingHypothesis(
            _weigh_gap(gap, interval),
            touch.t,
            touch.t_sigma,
            touch.place,
            touch.covariance,
            gap <= _SEEN_FRAMES * interval,
        )
    return predict_landing(flights[-1], sport, last_seen, interval) if flights else None


def _weigh_gap(gap: float, interval: float) -> float:
    """Return the probability that a flight goes on over a time, s, in which it is not seen."""
    return float(np.exp(-_HAZARD * max(gap - _FREE_FRAMES * interval, 0.0)))


def _weigh_surroundings(place: FloatArray, covariance: FloatArray, sport: Sport) -> float:
    """Return the probability that a place (3,) is near the court: what flies farther hits a wall, or is no flight."""
    chance = 1.0
    for axis, (low, high, softness) in enumerate(limit_places(sport)[:2]):
        sigma = float(np.hypot(np.sqrt(covariance[axis, axis]), softness))
        chance *= float(ndtr((high - place[axis]) / sigma) - ndtr((low - place[axis]) / sigma))
    return chance


def find_first_touch(events: tuple[RallyEvent, ...], hit: int, sport: Sport) -> RallyEvent | None:
    """Find where the object first touches the surface after a hit, before the next one.

    Args:
        events: Events, in the order of time.
        hit: Index of the hit; -1 for the begin of the clip.
        sport: Sport. A service of table tennis touches the half of the server first, which decides nothing.

    Returns:
        The bounce or landing; None without one.
    """
    is_service = sport.serves_on_own_half and not any(event.kind == "hit" for event in events[: max(hit, 0)])
    for event in events[hit + 1 :]:
        if event.kind == "hit":
            return None
        if event.kind in ("bounce", "landing"):
            middle = sport.length / 2
            if is_service and hit >= 0 and (event.place[0] > middle) == (events[hit].place[0] > middle):
                is_service = False
                continue
            return event
    return None


def merge_landings(
    hypotheses: list[tuple[float, LandingHypothesis | None]],
) -> tuple[tuple[LandingHypothesis, ...], float]:
    """Merge the landings of several explanations, where they agree.

    Args:
        hypotheses: Probability of each explanation, and its landing.

    Returns:
        Landings with their weights, the most probable first, and the probability that there is none.
    """
    merged: list[LandingHypothesis] = []
    nothing = 0.0
    for probability, landing in sorted(hypotheses, key=lambda one: -one[0]):
        if landing is None:
            nothing += probability
            continue
        weight = probability * landing.weight
        nothing += probability - weight
        for k, other in enumerate(merged):
            if _agree(landing, other):
                merged[k] = replace(other, weight=other.weight + weight)
                break
        else:
            merged.append(replace(landing, weight=weight))
    return tuple(sorted(merged, key=lambda one: -one.weight)), float(np.clip(nothing, 0.0, 1.0))


def _agree(one: LandingHypothesis, other: LandingHypothesis) -> bool:
    """Check whether two landings differ by less than a third of a standard deviation, or by 5 mm."""
    off: FloatArray = one.place - other.place
    deviation = np.sqrt(np.diag(other.covariance))
    is_close = np.abs(off) < np.maximum(deviation / 3, 0.005)
    return bool(is_close.all() and abs(one.t - other.t) < max(other.t_sigma, 0.01))
