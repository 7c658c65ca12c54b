"""A rally evaluated: where the object is at any time, and where it would have gone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.court import Sport
from models.core.rally import Flight, Rally
from models.core.typing import FloatArray
from models.physics.flight.flight_motion import find_descent, fly, fly_flight

# s by which a flight may end on the surface too early or too late.
CONTACT_TIME = 0.03
# s up to which a flight is continued: the highest lobs last less.
_LONGEST_FLIGHT = 6.0


@dataclass(frozen=True, slots=True)
class PlacesInSpace:
    """Places and velocities at K times."""

    t: FloatArray
    """(K,) s."""
    xyz: FloatArray
    """(K, 3) m; NaN where no flight is."""
    v: FloatArray
    """(K, 3) m/s."""
    covariance: FloatArray
    """(K, 3, 3) m^2, of the places."""


def evaluate_rally(rally: Rally, t: FloatArray) -> PlacesInSpace:
    """Evaluate a rally at times (K,), s; NaN where no flight covers a time."""
    t = np.asarray(t, np.float64)
    xyz, v, covariance = np.full((len(t), 3), np.nan), np.full((len(t), 3), np.nan), np.full((len(t), 3, 3), np.nan)
    for flight in rally.flights:
        rows = np.flatnonzero((t >= flight.start) & (t <= flight.end))
        if len(rows):
            order = rows[np.argsort(t[rows], kind="stable")]
            part = _evaluate_flight(flight, t[order], rally.scene.sport)
            xyz[order], v[order], covariance[order] = part.xyz, part.v, part.covariance
    return PlacesInSpace(t, xyz, v, covariance)


def continue_flight(rally: Rally, index: int, seconds: float, step: float = 0.01) -> PlacesInSpace:
    """Continue a flight as if nothing had ended it, until it reaches the playing surface or the floor.

    Args:
        index: Of the flight.
        seconds: Longest continuation, s after the end of the flight.
        step: s between places.

    Returns:
        Places from the end of the flight on; the last one lies on the surface where the object gets there in time.
    """
    flight, sport = rally.flights[index], rally.scene.sport
    # a flight that ends in a bounce is there already
    ahead = max(flight.end - flight.start - CONTACT_TIME, 0.0)
    contact = find_surface_contact(flight.parameters, flight.begins_with_hit, sport, ahead)
    last = min(flight.end + seconds, flight.start + contact) if np.isfinite(contact) else flight.end + seconds
    count = max(int(np.ceil((last - flight.end) / step)), 1)
    return _evaluate_flight(flight, np.linspace(flight.end, max(last, flight.end), count + 1), sport)


def find_surface_contact(parameters: FloatArray, begins_with_hit: bool, sport: Sport, after: float) -> float:
    """Find when a flight first touches the playing surface, or the floor beside a table.

    Args:
        parameters: (11,) of the flight.
        begins_with_hit: Whether a shuttle turns over at its start.
        after: s after the start of the flight, from which to look.

    Returns:
        s after the start; NaN where it does not happen within `_LONGEST_FLIGHT`.
    """
    turn_length = sport.object.turn_length if begins_with_hit else 0.0
    on_surface = find_descent(parameters, turn_length, sport.object.radius, after, after + _LONGEST_FLIGHT)
    if sport.floor == 0:
        return on_surface
    if np.isfinite(on_surface):
        place = fly(parameters, np.array([on_surface]), turn_length).states[0]
        if is_on_surface(place[:2], sport):
            return on_surface
    return find_descent(parameters, turn_length, sport.floor + sport.object.radius, after, after + _LONGEST_FLIGHT)


def is_on_surface(xy: FloatArray, sport: Sport) -> bool:
    """Check whether something at (2,) m touches the playing surface; without a table, the surface has no end."""
    margin = sport.object.radius
    inside = -margin <= xy[0] <= sport.length + margin and -margin <= xy[1] <= sport.width + margin
    return bool(sport.floor == 0 or inside)


def _evaluate_flight(flight: Flight, t: FloatArray, sport: Sport) -> PlacesInSpace:
    path = fly_flight(flight, t, sport.object)
    by = path.derivatives[:, :3]
    covariance = np.asarray(by @ flight.covariance @ by.transpose(0, 2, 1))
    return PlacesInSpace(t, path.states[:, :3], path.states[:, 3:], covariance)
