"""Doubtful events of a fitted rally, tried otherwise: left out, or of another kind.

The search over sequences compares flights that were fitted alone. Where a short flight begins or ends, or an event lies
near the ground, only the joint fit can tell; what loses by little stays as a rival explanation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from models.core.court import Sport
from models.core.rally import RallyEventKind
from models.core.typing import BoolArray, FloatArray
from models.estimation.rally.event_evidence import NET_DEPTH, contact_ranges, name_contact, turns_over
from models.estimation.rally.flight_fit import (
    FULL_SEARCH,
    SHARED_COUNT,
    RallyFit,
    RallyStructure,
    assign_times,
    flight_slice,
    refine_fit,
    start_row,
)
from models.estimation.rally.flight_observations import CLUTTER_COST, FlightObservations, weigh_marks
from models.estimation.rally.initial_flights import pin_to_surface
from models.estimation.rally.single_flight import Pin, build_flight_prior, fit_single_flight
from models.numerics.least_squares import SearchOptions
from models.physics.flight.flight_motion import fly

# Passes in which gains are taken over, and flights on each side of a doubtful event that are fitted with it.
_MOST_PASSES, _NEIGHBOURS = 4, 1
# s up to which events begin at the same time: what was tried once is not tried again.
_SAME_START = 0.02
# Steps after which a rival that is worse by so much evidence is given up: further ones gained a tenth of it at most
# where a rival came near.
_FIRST_LOOK = SearchOptions(iterations=8, attempts=5, min_gain=0.2, min_relative_gain=1e-3, damping=1e-2)
_HOPELESS = 100.0
# Events at the end of a rally whose rivals are fitted wholly, and how many of these.
_LAST_EVENTS, _MOST_RIVALS = 3, 4
# A flight of fewer observations, or shorter, s, may be none.
_FEW, _SHORT = 5, 0.3
# Standard deviations from the net or the surface up to which a hit may be there; m above the surface beyond these.
_FAR_SIGMAS, _NEAR_SURFACE = 4.0, 0.15
# s from such a hit to the bounce before it, and to the hit itself.
_RISE = (-0.04, 0.08)
# m by which a hit may lie elsewhere where the object leaves it in the other direction.
_TURN_SIGMA = 1.0
# Share of the length of the court by which the depth of a hit may be wrong where it is a bounce.
_DEPTH_SHARE = 0.5
# Natural logarithm of the evidence by which a rival may be worse and still counts.
WORST_RIVAL = 16.0


@dataclass(frozen=True, slots=True)
class Doubt:
    """An event that might be otherwise."""

    kind: RallyEventKind | None
    t: float
    """s."""
    gain: float
    """Natural logarithm of the evidence by which the other explanation is better; at most 0."""


@dataclass(frozen=True, slots=True)
class Revision:
    """The best explanation after doubtful events were tried otherwise."""

    best: RallyFit
    rivals: tuple[RallyFit, ...]
    """Other explanations of the last events, which decide on the landing."""
    doubts: tuple[Doubt, ...]


@dataclass(frozen=True, slots=True)
class _Variant:
    """An event taken otherwise: what the flights are then, and where their fit starts."""

    event: int
    structure: RallyStructure
    values: FloatArray
    """(P,) initial values."""
    pins: dict[int, Pin | None] = field(default_factory=dict)
    """Places of the events that move, None where that is open: the flights beside these are first fitted alone."""
    heading: float = 0.0
    """Sign of the speed along the court with which only the flight after the event is first fitted; 0 for any."""


@dataclass(frozen=True, slots=True)
class _Trial:
    """An event tried otherwise, with the flights around it fitted again."""

    event: int
    first: int
    stop: int
    """Flights of the explanation so far that were fitted again."""
    fit: RallyFit
    gain: float


def revise_structures(observed: FlightObservations, sport: Sport, fits: list[RallyFit]) -> list[Revision]:
    """Try the doubtful events of explanations otherwise, each with its neighbours alone.

    Args:
        observed: N observations.
        fits: Explanations that may be right.

    Returns:
        The best that was found from each of them, with its rivals and doubts; the best one first.
    """
    past: dict[tuple[object, ...], _Trial | None] = {}
    revisions = [_revise(observed, sport, fit, past) for fit in fits]
    return sorted(revisions, key=lambda revision: -weigh_fit(revision.best, observed))


def _revise(
    observed: FlightObservations, sport: Sport, fit: RallyFit, past: dict[tuple[object, ...], _Trial | None]
) -> Revision:
    """Improve an explanation, and its rivals where one of them comes out better."""
    revision = _improve(observed, sport, fit, past)
    for _ in range(_MOST_PASSES):
        # a rival that was fitted wholly may have come out better than it seemed beside its neighbours alone
        better = max(revision.rivals, key=lambda rival: weigh_fit(rival, observed), default=revision.best)
        if weigh_fit(better, observed) <= weigh_fit(revision.best, observed):
            break
        revision = _improve(observed, sport, better, past)
    return revision


def _improve(
    observed: FlightObservations, sport: Sport, fit: RallyFit, past: dict[tuple[object, ...], _Trial | None]
) -> Revision:
    """Take over what explains the clip better, until nothing does."""
    best, trials = fit, _try_variants(observed, sport, fit, past)
    for _ in range(_MOST_PASSES):
        gains = _select_gains(trials)
        if not gains:
            break
        structure, values = best.structure, best.values
        for trial in sorted(gains, key=lambda trial: -trial.first):  # the flights before it keep their numbers
            structure, values = _splice(structure, values, trial)
        other = refine_fit(observed, sport, structure, values)
        if other is None or weigh_fit(other, observed) <= weigh_fit(best, observed):
            break
        best, trials = other, _try_variants(observed, sport, other, past)
    return _collect_rivals(observed, sport, best, trials)


def _collect_rivals(observed: FlightObservations, sport: Sport, best: RallyFit, trials: list[_Trial]) -> Revision:
    """Fit the rivals of the last events wholly, and note the other doubts."""
    count, rivals, doubts = len(best.structure), list[RallyFit](), list[Doubt]()
    for trial in sorted(trials, key=lambda trial: -trial.gain):
        if trial.gain < -WORST_RIVAL:
            break
        structure, values = _splice(best.structure, best.values, trial)
        is_rival, gain = trial.event >= count - _LAST_EVENTS and len(rivals) < _MOST_RIVALS, trial.gain
        if is_rival or gain > 0:  # what gains beside its neighbours alone, and was not taken over, may gain nothing
            other = refine_fit(observed, sport, structure, values)
            gain = -np.inf if other is None else weigh_fit(other, observed) - weigh_fit(best, observed)
            rivals += [other] if other is not None and (is_rival or gain > 0) else []
        # the same events in other places leave no doubt that they happened, and what explains more becomes the best
        if not is_rival and gain <= 0 and structure.kinds != best.structure.kinds:
            start = float(best.values[start_row(trial.event, count)])
            doubts.append(Doubt(best.structure.kinds[trial.event], start, gain))
    return Revision(best, tuple(rivals), tuple(doubts))


def weigh_fit(fit: RallyFit, observed: FlightObservations) -> float:
    """Return the evidence of a fit, the observations that it leaves as clutter included."""
    explained = observed.is_resting.copy()
    explained[np.concatenate(assign_times(observed.t, fit.structure, fit.values))] = True
    starts = fit.values[start_row(0, len(fit.structure)) :]
    marked = weigh_marks(observed.marks, fit.structure.kinds, starts)
    return fit.evidence + marked - CLUTTER_COST * int((~explained).sum())


def leave_out_flights(
    structure: RallyStructure, values: FloatArray, is_out: BoolArray
) -> tuple[RallyStructure, FloatArray]:
    """Leave out flights (F,): what follows one is joined to nothing, and what precedes it ends where it began."""
    count, stays = len(structure), ~is_out
    starts = values[start_row(0, count) :]
    begin, end, joined = structure.begin.copy(), structure.end.copy(), np.array(structure.joined)
    for k in range(1, count):
        if joined[k] and is_out[k - 1] != is_out[k]:
            joined[k], begin[k], end[k - 1] = False, starts[k], starts[k]
    rest = RallyStructure(
        tuple(kind for kind, stay in zip(structure.kinds, stays, strict=True) if stay),
        tuple(joined[stays].tolist()),
        begin[stays],
        end[stays],
        structure.heights[stays],
    )
    parts = [values[flight_slice(k)] for k in range(count) if stays[k]]
    return rest, np.concatenate([values[:SHARED_COUNT], *parts, starts[stays]])


def goes_on_after_landing(structure: RallyStructure) -> bool:
    """Check whether somebody plays on after a landing, which does not happen."""
    kinds = structure.kinds
    after = kinds[kinds.index("landing") :] if "landing" in kinds else ()
    return "hit" in after or None in after


def _select_gains(trials: list[_Trial]) -> list[_Trial]:
    """Select trials that explain the clip better and do not overlap, the best first."""
    selected: list[_Trial] = []
    for trial in sorted(trials, key=lambda trial: -trial.gain):
        apart = all(trial.stop <= other.first or trial.first >= other.stop for other in selected)
        if trial.gain > 0 and apart:
            selected.append(trial)
    return selected


def _try_variants(
    observed: FlightObservations, sport: Sport, fit: RallyFit, past: dict[tuple[object, ...], _Trial | None]
) -> list[_Trial]:
    """Try the doubtful events otherwise; what was tried before, among the same events, is taken from `past`."""
    trials: list[_Trial] = []
    count, originals = len(fit.structure), dict[int, tuple[FlightObservations, float]]()
    for variant in _vary(observed, sport, fit):
        event, structure = variant.event, variant.structure
        if goes_on_after_landing(structure) and not goes_on_after_landing(fit.structure):
            continue
        first, stop = max(event - 1 - _NEIGHBOURS, 0), min(event + 1 + _NEIGHBOURS, count)
        stop = count if len(variant.pins) > 1 else stop  # a landing changes all that follows
        fewer = count - len(structure)
        key = (
            _describe_events(fit.structure, fit.values, first, stop),
            _describe_events(structure, variant.values, first, stop - fewer),
            variant.heading,
        )
        if key not in past:
            past[key] = None
            if event not in originals:
                part, original = _fit_part(observed, sport, fit.structure, fit.values, first, stop, FULL_SEARCH)
                if original is None:
                    continue
                originals[event] = part, weigh_fit(original, part)
            part, before = originals[event]
            values = _pin_flights(observed, sport, variant)
            _, other = _fit_part(observed, sport, structure, values, first, stop - fewer, _FIRST_LOOK)
            if other is not None and weigh_fit(other, part) > before - _HOPELESS:
                other = refine_fit(part, sport, other.structure, other.values)
            if other is not None:
                past[key] = _Trial(event, first, stop, other, weigh_fit(other, part) - before)
        trial = past[key]
        if trial is not None:
            trials.append(replace(trial, event=event, first=first, stop=stop))
    return trials


def _describe_events(structure: RallyStructure, values: FloatArray, first: int, stop: int) -> tuple[object, ...]:
    starts = values[start_row(first, len(structure)) : start_row(stop, len(structure))]
    heights = structure.heights[first:stop].tolist()
    moments = np.round(starts / _SAME_START).tolist()
    return tuple(zip(structure.kinds[first:stop], moments, heights, strict=True))


def _fit_part(
    observed: FlightObservations,
    sport: Sport,
    structure: RallyStructure,
    values: FloatArray,
    first: int,
    stop: int,
    search: SearchOptions,
) -> tuple[FlightObservations, RallyFit | None]:
    """Fit flights `first` to `stop` alone, to their observations."""
    count = len(structure)
    starts = values[start_row(0, count) :]
    rows = np.concatenate(assign_times(observed.t, structure, values)[first:stop])
    begin, end = structure.begin[first:stop].copy(), structure.end[first:stop].copy()
    if structure.joined[first]:
        begin[0] = starts[first]
    if stop < count and structure.joined[stop]:
        end[-1] = starts[stop]
    joined = (False, *structure.joined[first + 1 : stop])
    part = RallyStructure(structure.kinds[first:stop], joined, begin, end, structure.heights[first:stop])
    own = values[flight_slice(first).start : flight_slice(stop).start]
    values = np.concatenate([values[:SHARED_COUNT], own, starts[first:stop]])
    return observed.select(rows), refine_fit(observed.select(rows), sport, part, values, search)


def _splice(structure: RallyStructure, values: FloatArray, trial: _Trial) -> tuple[RallyStructure, FloatArray]:
    """Put the flights of a trial in the place of those that it explains otherwise."""
    count, part, own = len(structure), trial.fit.structure, trial.fit.values
    a, b = trial.first, trial.stop
    starts, own_starts = values[start_row(0, count) :], own[start_row(0, len(part)) :]
    begin, end = part.begin.copy(), part.end.copy()
    begin[0], end[-1] = structure.begin[a], structure.end[b - 1]
    spliced = RallyStructure(
        structure.kinds[:a] + part.kinds + structure.kinds[b:],
        structure.joined[: a + 1] + part.joined[1:] + structure.joined[b:],
        np.concatenate([structure.begin[:a], begin, structure.begin[b:]]),
        np.concatenate([structure.end[:a], end, structure.end[b:]]),
        np.concatenate([structure.heights[:a], part.heights, structure.heights[b:]]),
    )
    flights = [values[: flight_slice(a).start], own[SHARED_COUNT : start_row(0, len(part))]]
    rest = values[flight_slice(b).start : start_row(0, count)]
    return spliced, np.concatenate([*flights, rest, starts[:a], own_starts, starts[b:]])


def _vary(observed: FlightObservations, sport: Sport, fit: RallyFit) -> Iterator[_Variant]:
    """Yield doubtful events taken otherwise."""
    structure, values, count = fit.structure, fit.values, len(fit.structure)
    sizes = np.array([len(rows) for rows in assign_times(observed.t, structure, values)])
    starts = values[start_row(0, count) :]
    lengths = np.diff(np.append(starts, structure.end[-1]))
    is_short = (sizes < _FEW) | (lengths < _SHORT)
    for k in range(1, count):
        if not structure.joined[k]:
            continue
        doubtful = is_short[k - 1] or is_short[k] or structure.kinds[k] == "net"
        if structure.kinds[k] == "hit":
            place, way = values[flight_slice(k)][[0, 3]]
            came = fly(values[flight_slice(k - 1)], starts[[k]] - starts[k - 1], structure.turn_length(k - 1, sport))
            # a player sends the object back, and to the other half; one camera may take either direction for the other
            if way * came.states[0, 3] > 0 or (place < sport.length / 2) != (way > 0):
                doubtful, pin = True, Pin(float(starts[k]), values[flight_slice(k)][:3], np.full(3, _TURN_SIGMA))
                yield _Variant(k, structure, values, {k: pin}, -float(np.sign(way)))
                yield _Variant(k, structure, values, {k: None})
        if doubtful:
            yield _merge(fit, k, bool(sizes[k] > sizes[k - 1]), sport)
    for k in range(1, count):
        if structure.joined[k]:
            volley = structure.kinds[k] == "hit" and structure.kinds[k - 1] != "bounce"
            yield from _flip(observed, fit, k, sport)
            yield from _change_surface(observed, fit, k, sport)
            yield from _add_bounce(observed, fit, k, sport) if volley else ()


def _merge(fit: RallyFit, k: int, is_later_longer: bool, sport: Sport) -> _Variant:
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
    return _Variant(k, fewer, np.concatenate([values[:SHARED_COUNT], *parts, starts[stays]]))


def _flip(observed: FlightObservations, fit: RallyFit, k: int, sport: Sport) -> Iterator[_Variant]:
    """Take an event for one of another kind: a bounce or a touch of the net only where one might be."""
    structure, count, contact = fit.structure, len(fit.structure), name_contact(sport)
    x, row, stated = float(fit.values[flight_slice(k)][0]), flight_slice(k).start, structure.kinds[k]
    is_at_net = abs(x - sport.length / 2) < _FAR_SIGMAS * np.sqrt(max(fit.covariance[row, row], 0.0)) + NET_DEPTH
    if stated != "hit" or is_at_net:
        kinds = list(structure.kinds)
        kinds[k] = "net" if stated == "hit" else "hit"
        # a net holds the flights beside it in its own depth, from where the fit does not find that of a player
        yield _Variant(k, replace(structure, kinds=tuple(kinds)), fit.values, {k: None} if stated == "net" else {})
    # nobody plays on after a landing: what follows it are hops, and few
    if stated not in ("hit", "net") or (contact == "landing" and k < count - _LAST_EVENTS):
        return
    changed = [j for j in range(k, count) if j == k or (contact == "landing" and structure.kinds[j] != "landing")]
    kinds, heights, pins = list(structure.kinds), structure.heights.copy(), dict[int, Pin | None]()
    for j in changed:
        pin = _find_contact(observed, fit, j, sport)
        if pin is None:
            return
        kinds[j], pins[j] = contact, pin
        heights[j] = sport.floor if sport.is_beside_table(pin.place[2]) else 0.0
    yield _Variant(k, replace(structure, kinds=tuple(kinds), heights=heights), fit.values, pins)


def _change_surface(observed: FlightObservations, fit: RallyFit, k: int, sport: Sport) -> list[_Variant]:
    """Take one of the last bounces on a table for one on the floor, and the other way round: one ray meets both."""
    structure, count = fit.structure, len(fit.structure)
    if sport.floor == 0 or structure.kinds[k] != "bounce" or k < count - _LAST_EVENTS:
        return []
    start, heights = float(fit.values[start_row(k, count)]), structure.heights.copy()
    heights[k] = sport.floor if heights[k] == 0 else 0.0
    row = min(int(np.searchsorted(observed.t, start)), len(observed) - 1)
    place = fit.values[flight_slice(k)][:3]
    pin = pin_to_surface(observed.matrix[row], place, start, sport, (float(heights[k]),))
    return [] if pin is None else [_Variant(k, replace(structure, heights=heights), fit.values, {k: pin})]


def _add_bounce(observed: FlightObservations, fit: RallyFit, k: int, sport: Sport) -> list[_Variant]:
    """Put a bounce just before the hit that begins flight k: a ball that is hit as it rises is easily taken for one."""
    structure, values, count = fit.structure, fit.values, len(fit.structure)
    starts = values[start_row(0, count) :]
    begin, end = starts[k] + np.array(_RISE)
    before, after = values[flight_slice(k - 1)], values[flight_slice(k)].copy()
    if sport.object.restitution is None or begin < starts[k - 1] or end > structure.end[k]:
        return []
    state = fly(before, np.array([begin - starts[k - 1]]), structure.turn_length(k - 1, sport)).states[0]
    row = min(int(np.searchsorted(observed.t, begin)), len(observed) - 1)
    pin = pin_to_surface(observed.matrix[row], state[:3], float(begin), sport)
    after[:6] = fly(after, np.array([end - starts[k]]), 0.0).states[0]
    if pin is None or np.linalg.norm(state[:3] - pin.place) > _DEPTH_SHARE * sport.length:
        return []
    restitution, retention = contact_ranges(sport)
    rising = before.copy()
    rising[:3], rising[3:6] = pin.place, state[3:] * [retention.mean, retention.mean, -restitution.mean]
    more = RallyStructure(
        (*structure.kinds[:k], "bounce", *structure.kinds[k:]),
        (*structure.joined[: k + 1], True, *structure.joined[k + 1 :]),
        np.insert(structure.begin, k, begin),
        np.insert(structure.end, k, end),
        np.insert(structure.heights, k, sport.floor if sport.is_beside_table(pin.place[2]) else 0.0),
    )
    flights = [values[: flight_slice(k).start], rising, after, values[flight_slice(k + 1).start : start_row(0, count)]]
    return [_Variant(k, more, np.concatenate([*flights, starts[:k], [begin, end], starts[k + 1 :]]))]


def _find_contact(observed: FlightObservations, fit: RallyFit, k: int, sport: Sport) -> Pin | None:
    """Find where the event that begins flight k is on the surface; None where it cannot be there."""
    place, start = fit.values[flight_slice(k)][:3], float(fit.values[start_row(k, len(fit.structure))])
    row = min(int(np.searchsorted(observed.t, start)), len(observed) - 1)
    pin = pin_to_surface(observed.matrix[row], place, start, sport)
    deviation = float(np.sqrt(max(fit.covariance[flight_slice(k), flight_slice(k)][2, 2], 0.0)))
    return pin if pin is not None and _may_bounce(pin, place, deviation, sport) else None


def _may_bounce(pin: Pin, place: FloatArray, sigma: float, sport: Sport) -> bool:
    """Check whether a hit is near the surface, or in a depth that a bounce would correct within the surroundings."""
    behind, beside = sport.surroundings
    inside = -behind < pin.place[0] < sport.length + behind and -beside < pin.place[1] < sport.width + beside
    is_near = abs(place[2] - pin.place[2]) < _FAR_SIGMAS * sigma + _NEAR_SURFACE
    return bool(is_near or (inside and np.linalg.norm(place - pin.place) < _DEPTH_SHARE * sport.length))


def _pin_flights(observed: FlightObservations, sport: Sport, variant: _Variant) -> FloatArray:
    """Fit the flights beside the moved events of a variant alone, through their places; return all values."""
    structure, values, prior = variant.structure, variant.values.copy(), build_flight_prior(sport)
    rows_of = assign_times(observed.t, structure, values)
    flights = {j for k in variant.pins for j in (k - 1, k)} if variant.heading == 0 else {variant.event}
    for j in sorted(flights):
        if len(rows_of[j]) < 2:
            continue
        part, turns = observed.select(rows_of[j]), turns_over(structure.kinds[j])
        # the events on its other side stay about where they are
        near = {
            k: Pin(float(values[start_row(k, len(structure))]), values[flight_slice(k)][:3], np.full(3, _TURN_SIGMA))
            for k in (j, j + 1)
            if k < len(structure) and structure.joined[k]
        }
        pins = tuple(pin for pin in (variant.pins.get(k, near.get(k)) for k in (j, j + 1)) if pin is not None)
        flight = fit_single_flight(part, sport, prior, turns, variant.heading, pins)
        if flight is None:
            continue
        moved = fly(flight.parameters, np.array([values[start_row(j, len(structure))] - part.t[0]]), 0.0).states[0]
        if np.linalg.norm(moved[3:]) < 1.5 * sport.object.max_speed:
            values[flight_slice(j)] = np.append(moved, flight.parameters[6:])
    return values
