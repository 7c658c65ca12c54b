"""Flights of a hypothesis brought to agree before they are fitted together.

A flight seen by one camera may fit in several depths. A bounce fixes it: the object is then where the camera's ray
meets the surface. From there the places of hits follow, flight by flight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.court import Sport
from models.core.typing import FloatArray
from models.estimation.rally.event_evidence import turns_over
from models.estimation.rally.flight_observations import FlightObservations
from models.estimation.rally.flight_segmentation import FlightGuess, RallyHypothesis
from models.estimation.rally.single_flight import Pin, SingleFlight, build_flight_prior, fit_single_flight
from models.physics.flight.flight_motion import FlightPath, fly

# m by which a place on the surface is known, along it and in height, before the time of the bounce is fitted.
_SURFACE_SIGMA = (0.4, 0.4, 0.03)
# m, least and largest error that the end of a neighbouring flight may claim: it was fitted alone.
_LEAST_ERROR, _LARGEST_ERROR = 0.15, 3.0


def align_flights(observed: FlightObservations, sport: Sport, hypothesis: RallyHypothesis) -> RallyHypothesis:
    """Fit the flights of a hypothesis again, with bounces on the surface and with the ends of their neighbours.

    Args:
        observed: N observations.
        hypothesis: Flights that were fitted alone.

    Returns:
        The same flights in the depth that their events require.
    """
    guesses = list(hypothesis.flights)
    count = len(guesses)
    surface = {
        k: pin
        for k in range(1, count)
        if guesses[k].is_joined and guesses[k].kind in ("bounce", "landing")
        for pin in [_find_surface(observed, sport, guesses[k - 1], guesses[k].t)]
        if pin is not None
    }
    for k in range(count):
        pins = tuple(surface[j] for j in (k, k + 1) if j in surface)
        if pins:
            guesses[k] = _fit_again(observed, sport, guesses[k], pins)
    for order in (range(count), range(count - 1, -1, -1)):
        for k in order:
            pins = tuple(surface[j] for j in (k, k + 1) if j in surface)
            if len(pins) == 2:
                continue
            neighbours = []
            if k > 0 and guesses[k].is_joined and k not in surface:
                neighbours.append(_end_of(observed, sport, guesses[k - 1], guesses[k].t))
            if k + 1 < count and guesses[k + 1].is_joined and k + 1 not in surface:
                neighbours.append(_end_of(observed, sport, guesses[k + 1], guesses[k + 1].t))
            pins += tuple(pin for pin in neighbours if pin is not None)
            if pins:
                guesses[k] = _fit_again(observed, sport, guesses[k], pins)
    return replace(hypothesis, flights=tuple(guesses))


def _fit_again(observed: FlightObservations, sport: Sport, guess: FlightGuess, pins: tuple[Pin, ...]) -> FlightGuess:
    part = observed.select(slice(guess.first, guess.last + 1))
    turns, prior = turns_over(guess.kind), build_flight_prior(sport)
    best: SingleFlight | None = None
    for heading in (1.0, -1.0):
        flight = fit_single_flight(part, sport, prior, turns, heading, pins)
        if flight is not None and (best is None or flight.cost < best.cost):
            best = flight
    return guess if best is None else replace(guess, flight=best)


def _find_surface(observed: FlightObservations, sport: Sport, before: FlightGuess, t: float) -> Pin | None:
    """Find where a bounce, seen where the flight before it ends, is on the table or the floor."""
    place = _fly_guess(observed, sport, before, t).states[0, :3]
    return pin_to_surface(observed.matrix[before.last], place, t, sport)


def pin_to_surface(
    matrix: FloatArray, place: FloatArray, t: float, sport: Sport, heights: tuple[float, ...] = ()
) -> Pin | None:
    """Move a place along the camera's ray to the table or the floor.

    Args:
        matrix: (3, 4) projection.
        place: (3,) m, in whatever depth.
        t: s.
        heights: m, of the surfaces that may be met; the table, then the floor, without any.

    Returns:
        Where the ray meets the surface; None where the place is not finite.
    """
    if not np.isfinite(place).all():
        return None
    homogeneous = matrix[:, :3] @ place + matrix[:, 3]
    for height in heights or dict.fromkeys((0.0, sport.floor)):
        place = _meet_plane(matrix, homogeneous, height + sport.object.radius)
        on_table = bool(((place[:2] > -0.05) & (place[:2] < np.array([sport.length, sport.width]) + 0.05)).all())
        if height == sport.floor or on_table:
            return Pin(t, place, np.array(_SURFACE_SIGMA))
    return None


def _meet_plane(matrix: FloatArray, homogeneous: FloatArray, z: float) -> FloatArray:
    """Find the place (3,) at height z that a projection (3, 4) shows at homogeneous pixels (3,)."""
    plane = np.column_stack([matrix[:, 0], matrix[:, 1], matrix[:, 2] * z + matrix[:, 3]])
    xy = np.linalg.solve(plane, homogeneous)
    return np.array([xy[0] / xy[2], xy[1] / xy[2], z])


def _fly_guess(observed: FlightObservations, sport: Sport, guess: FlightGuess, t: float) -> FlightPath:
    turns = guess.flight.turns
    return fly(guess.flight.parameters, np.array([t - observed.t[guess.first]]), sport.object.turn_length * turns)


def _end_of(observed: FlightObservations, sport: Sport, guess: FlightGuess, t: float) -> Pin | None:
    """Return where a neighbouring flight is at an event."""
    path = _fly_guess(observed, sport, guess, t)
    place, by = path.states[0, :3], path.derivatives[0, :3]
    if not np.isfinite(place).all():
        return None
    sigma = np.sqrt(np.maximum(np.diag(by @ guess.flight.covariance @ by.T), 0.0)) * 2
    return Pin(t, place, np.clip(sigma, _LEAST_ERROR, _LARGEST_ERROR))
