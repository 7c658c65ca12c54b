"""Doubtful events of a fitted rally, tried otherwise: left out, or of another kind.

The search over sequences compares flights that were fitted alone. Where a short flight begins or ends, or an event lies
near the ground, only the joint fit can tell; what loses by little stays as a rival explanation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from models.core.court import Sport
from models.core.typing import FloatArray
from models.estimation.rally.event_evidence import name_contact
from models.estimation.rally.flight_fit import (
    RallyFit,
    RallyStructure,
    assign_times,
    flight_slice,
    refine_fit,
    start_row,
)
from models.estimation.rally.flight_observations import FlightObservations
from models.estimation.rally.initial_flights import pin_to_surface
from models.estimation.rally.single_flight import Pin, build_flight_prior, fit_single_flight
from models.physics.flight.flight_motion import PARAMETER_COUNT, fly

# Joint fits that are tried, at most: half a second of work.
_MOST_TRIALS = 20
# A flight of fewer observations, or shorter, s, may be none.
_FEW, _SHORT = 5, 0.3
# m above the surface, beyond four standard deviations, up to which a hit may be a bounce.
_NEAR_SURFACE = 0.15
# Share of the length of the court by which the depth of a hit may be wrong where it is a bounce.
_DEPTH_SHARE = 0.5
# Natural logarithm by which a rival may be worse and still counts.
_WORST_RIVAL = 16.0


def revise_structure(
    observed: FlightObservations, sport: Sport, fit: RallyFit, weigh: Callable[[RallyFit], float]
) -> list[RallyFit]:
    """Try the doubtful events of a rally otherwise.

    Args:
        observed: N observations.
        fit: The best explanation so far.
        weigh: Computes the evidence of an explanation.

    Returns:
        The best explanation found, and its rivals.
    """
    best, rivals, trials = fit, list[RallyFit](), 0
    is_better = True
    past_trials: set[tuple[object, ...]] = {_describe(fit)}
    while is_better and trials < _MOST_TRIALS:
        is_better = False
        for structure, values in _vary(observed, sport, best):
            key = _describe_parts(structure, values)
            if key in past_trials or trials >= _MOST_TRIALS:
                continue
            past_trials.add(key)
            trials += 1
            other = refine_fit(observed, sport, structure, values)
            if other is None:
                continue
            if weigh(other) > weigh(best):
                best, is_better = other, True
                rivals.append(best)
                break
            rivals.append(other)
    least = weigh(best) - _WORST_RIVAL
    return [best, *(rival for rival in [fit, *rivals] if rival is not best and weigh(rival) > least)]


def _describe(fit: RallyFit) -> tuple[object, ...]:
    return _describe_parts(fit.structure, fit.values)


def _describe_parts(structure: RallyStructure, values: FloatArray) -> tuple[object, ...]:
    starts = values[1 + PARAMETER_COUNT * len(structure) :]
    return tuple(zip(structure.kinds, np.round(starts, 1).tolist(), structure.heights.tolist(), strict=True))


def _vary(observed: FlightObservations, sport: Sport, fit: RallyFit) -> Iterator[tuple[RallyStructure, FloatArray]]:
    """Yield structures with initial values that differ in one doubtful event."""
    structure, values, count = fit.structure, fit.values, len(fit.structure)
    sizes = np.array([len(rows) for rows in assign_times(observed.t, structure, values)])
    starts = values[start_row(0, count) :]
    lengths = np.diff(np.append(starts, structure.end[-1]))
    is_short = (sizes < _FEW) | (lengths < _SHORT)
    deviation = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    flips: list[tuple[RallyStructure, FloatArray]] = []
    for k in range(1, count):
        if not structure.joined[k]:
            continue
        doubtful = is_short[k - 1] or is_short[k]
        if structure.kinds[k] == "hit" and structure.kinds[k - 1] in ("hit", None):
            sides = values[[flight_slice(k - 1).start, flight_slice(k).start]] < sport.length / 2
            doubtful = doubtful or bool(sides[0] == sides[1])
        if doubtful:
            yield _merge(fit, k, bool(sizes[k] > sizes[k - 1]), sport)
    for k in range(1, count):
        if structure.joined[k]:
            flips += _flip(observed, fit, k, deviation, sport)
    yield from flips


def _merge(fit: RallyFit, k: int, is_later_longer: bool, sport: Sport) -> tuple[RallyStructure, FloatArray]:
    """Leave out the event that begins flight k, and let one flight take the place of two."""
    structure, values, count = fit.structure, fit.values, len(fit.structure)
    parts = [values[flight_slice(j)].copy() for j in range(count)]
    starts = values[start_row(0, count) :]
    if is_later_longer:
        merged = parts[k].copy()
        merged[:6] = fly(parts[k], np.array([starts[k - 1] - starts[k]]), 0.0).states[0]
        if np.isfinite(merged).all() and np.linalg.norm(merged[3:6]) < sport.object.max_speed:
            parts[k - 1] = merged
    del parts[k]
    stays = np.arange(count) != k
    end = structure.end.copy()
    end[k - 1] = end[k]
    fewer = RallyStructure(
        tuple(kind for kind, stay in zip(structure.kinds, stays, strict=True) if stay),
        tuple(joined for joined, stay in zip(structure.joined, stays, strict=True) if stay),
        structure.begin[stays],
        end[stays],
        structure.heights[stays],
    )
    return fewer, np.concatenate([values[:1], *parts, starts[stays]])


def _flip(
    observed: FlightObservations, fit: RallyFit, k: int, deviation: FloatArray, sport: Sport
) -> list[tuple[RallyStructure, FloatArray]]:
    """Take a bounce for a hit, or a hit that is seen where a bounce might be for a bounce."""
    structure, at = fit.structure, flight_slice(k).start
    kinds = list(structure.kinds)
    if kinds[k] in ("bounce", "landing"):
        kinds[k] = "hit"
        return [(replace(structure, kinds=tuple(kinds)), fit.values.copy())]
    start = float(fit.values[start_row(k, len(structure))])
    row = min(int(np.searchsorted(observed.t, start)), len(observed) - 1)
    pin = pin_to_surface(observed.matrix[row], fit.values[at : at + 3], start, sport)
    if kinds[k] != "hit" or pin is None or not _may_bounce(pin, fit.values[at : at + 3], deviation[at + 2], sport):
        return []
    kinds[k] = name_contact(sport)
    heights = structure.heights.copy()
    heights[k] = sport.floor if pin.place[2] < sport.floor / 2 else 0.0
    changed = replace(structure, kinds=tuple(kinds), heights=heights)
    return [(changed, _pin_flights(observed, fit, changed, k, pin, sport))]


def _may_bounce(pin: Pin, place: FloatArray, sigma: float, sport: Sport) -> bool:
    """Check whether a hit is near the surface, or in a depth that a bounce would correct within the surroundings."""
    behind, beside = sport.surroundings
    inside = -behind < pin.place[0] < sport.length + behind and -beside < pin.place[1] < sport.width + beside
    is_near = abs(place[2] - pin.place[2]) < 4 * sigma + _NEAR_SURFACE
    return bool(is_near or (inside and np.linalg.norm(place - pin.place) < _DEPTH_SHARE * sport.length))


def _pin_flights(
    observed: FlightObservations, fit: RallyFit, structure: RallyStructure, k: int, pin: Pin, sport: Sport
) -> FloatArray:
    """Fit the flights on both sides of a bounce again, through its place."""
    values, count, prior = fit.values.copy(), len(structure), build_flight_prior(sport)
    rows_of = assign_times(observed.t, structure, values)
    for j in (k - 1, k):
        if len(rows_of[j]) < 2:
            continue
        part = observed.select(rows_of[j])
        turns = structure.kinds[j] in (None, "hit")
        flights = [fit_single_flight(part, sport, prior, turns, heading, (pin,)) for heading in (1.0, -1.0)]
        usable = [flight for flight in flights if flight is not None]
        if not usable:
            continue
        p = min(usable, key=lambda flight: flight.cost).parameters.copy()
        moved = fly(p, np.array([values[start_row(j, count)] - part.t[0]]), 0.0).states[0]
        if np.linalg.norm(moved[3:]) < 1.5 * sport.object.max_speed:
            values[flight_slice(j)] = np.append(moved, p[6:])
    return values
