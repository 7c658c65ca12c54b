"""A rally built from one fit: flights with their whole errors, events, and the landing."""

from __future__ import annotations

from dataclasses import replace
from itertools import takewhile
from math import prod

import numpy as np
from scipy.special import chdtri, ndtr

from models.core.court import Sport
from models.core.court_camera import CourtScene
from models.core.rally import BallCandidates, Flight, LandingHypothesis, Rally, RallyEvent, RallyEventKind
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.rally.event_chances import LOW_HIT, UNSEEN_START
from models.estimation.rally.event_evidence import name_contact, turns_over
from models.estimation.rally.flight_fit import RallyFit, assign_times, flight_slice, start_row
from models.estimation.rally.flight_observations import (
    CLUTTER_COST,
    EVEN_SQUARES,
    bound_residuals,
    compare_places,
    weigh_by_law,
)
from models.estimation.rally.guided_association import GATE, Sight, observe_candidates
from models.estimation.rally.landing_hypotheses import find_landing, predict_landing
from models.estimation.rally.rally_views import is_on_surface
from models.numerics.least_squares import RIDGE, invert_semidefinite
from models.numerics.statistics import correlation_factor, measure_lack_of_fit
from models.physics.flight.flight_motion import PARAMETER_COUNT, fly, fly_flight

# Steps of differences by the parameters of a camera: m, rad, logarithm of the focal length, k1.
CAMERA_STEPS = np.array([0.01, 0.01, 0.01, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3])
# m above four standard deviations of the surface, up to which a hit may be a bounce.
_LOW_HEIGHT = 0.1
# Probability that residuals are this small by chance, from which a smaller error of places is believed.
_CHANCE = 0.05
# Places from which the looks of a flight are judged: a hit blurs two or three.
_JUDGED_PLACES = 4
# Places from which the flight before the first bounce of a clip is known: four numbers fix the place and the way of a
# flight in the image, and one more confirms it.
_LEAST_BEFORE_BOUNCE = 5
# s before a flight in which the object may last have been seen, in a hand.
_HAND_GAP = 0.4
# Share of the length of the court that the first stroke of a rally drives the object at least: less is a toss.
_TOSS_SHARE = 0.15


def _estimate_covariance(
    scene: CourtScene,
    candidates: BallCandidates,
    frame: IntArray,
    t: FloatArray,
    sight: Sight,
    fit: RallyFit,
) -> tuple[FloatArray, list[float], BoolArray]:
    """Estimate the covariance of all values, chi2 per degree of freedom of each flight, and which places were used.

    The errors of places are scaled by the size of the residuals in nominal errors; the errors of the camera, which all
    observations share, are added (consider covariance: Bierman 1977, section VIII.2).
    """
    camera, sport = scene.camera, scene.sport
    structure, values, count = fit.structure, fit.values, len(fit.structure)
    rows_of = assign_times(sight.observed.t, structure, values)
    shifted = []
    for j in range(len(CAMERA_STEPS)):
        moved = camera.parameters.copy()
        moved[j] += CAMERA_STEPS[j]
        changed = replace(scene, camera=camera.replace_parameters(moved))
        shifted.append(observe_candidates(changed, candidates, frame, t, sight.chosen, sight.rows))
    series, chi2, pull = [], [], np.zeros((len(values), len(CAMERA_STEPS)))
    observed_information = np.zeros_like(fit.information)
    used = np.zeros(len(sight.rows), np.bool_)
    for k, rows in enumerate(rows_of):
        part, start = flight_slice(k), values[start_row(k, count)]
        observed = sight.observed.select(rows)
        path = fly(values[part], observed.t - start, structure.turn_length(k, sport))
        residual, by_place = compare_places(observed, path.states[:, :3])
        weight = weigh_by_law(by_place, path.states[:, :3], sport.object)
        residual, by_place = residual * weight[:, None], by_place * weight[:, None, None]
        factor, slope = bound_residuals(residual, most=observed.bound_clutter(CLUTTER_COST))
        bounded = residual * factor[:, None]
        used[rows] = (residual**2).sum(axis=1) < GATE**2
        # the others more probably show another thing, and leave gaps: neighbours stay neighbours
        is_flight = (bounded**2).sum(axis=1, keepdims=True) < EVEN_SQUARES
        series.append(np.where(is_flight, bounded, np.nan))
        freedom = 2 * int(used[rows].sum()) - 6
        chi2.append(float((bounded[used[rows]] ** 2).sum()) / freedom if freedom > 0 else float("nan"))
        by = np.concatenate([by_place @ path.derivatives[:, :3], -by_place @ path.states[:, 3:, None]], axis=2)
        columns = np.append(np.arange(part.start, part.stop), start_row(k, count))
        bent = (by * slope[:, None, None]).reshape(-1, len(columns))
        bent[:, -1] *= structure.joined[k]  # else the start is fixed
        observed_information[np.ix_(columns, columns)] += bent.T @ bent
        for j, other in enumerate(shifted):
            change = (
                compare_places(other.select(rows), path.states[:, :3])[0] * weight[:, None] - residual
            ) / CAMERA_STEPS[j]
            pull[columns, j] += np.einsum("nip,ni,n->p", by, change, slope**2)
    free = min(6 * count, max(sum(2 * len(rows) for rows in rows_of) - 1, 0))
    moved_by = fit.covariance @ pull
    covariance = scale_covariance(fit.information, observed_information, estimate_error_scale(series, free))
    return covariance + moved_by @ camera.covariance @ moved_by.T, chi2, used


def estimate_error_scale(series: list[FloatArray], free: int) -> float:
    """Estimate the factor on the nominal variances of places that their residuals show.

    The hundreds of places of a clip tell how large their errors are, be it less than a detector claims; a few may lie
    close by chance. A factor below 1 is the largest that the residuals do not contradict.

    Args:
        series: Bounded residuals (K, 2) of each flight, standard deviations, in the order of time; NaN for no residual.
        free: Number of fitted parameters.
    """
    per_freedom, _ = measure_lack_of_fit(series, free)
    if not np.isfinite(per_freedom):
        return 1.0
    freedom = sum(int(np.isfinite(one).sum()) for one in series) - free
    largest = per_freedom * freedom / float(chdtri(freedom, 1 - _CHANCE))
    return max(per_freedom, min(1.0, largest)) * correlation_factor(series)


def scale_covariance(information: FloatArray, observed: FloatArray, scale: float) -> FloatArray:
    """Invert an information (P, P) whose part of observations has other variances by a factor, and the priors not."""
    return invert_semidefinite(information - (1 - 1 / max(scale, RIDGE)) * observed)


def build_rally(
    scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray, sight: Sight, fit: RallyFit
) -> Rally:
    """Build the rally of one fit, with its landing."""
    sport, structure, values, count = scene.sport, fit.structure, fit.values, len(fit.structure)
    covariance, chi2, used = _estimate_covariance(scene, candidates, frame, t, sight, fit)
    interval = float(np.median(np.diff(t)))
    flights: list[Flight] = []
    events: list[RallyEvent] = []
    rally = _fill_places(scene, candidates, frame, t, sight, used)
    chances = weigh_flights(candidates, sight, fit, used)
    for k in range(count):
        part, at = flight_slice(k), start_row(k, count)
        p, start, kind = values[part], float(values[at]), structure.kinds[k]
        is_ended = k + 1 < count and structure.joined[k + 1]
        end = float(values[at + 1]) if is_ended else float(structure.end[k])
        columns = np.append(np.arange(part.start, part.stop), at)
        block = covariance[np.ix_(columns, columns)]
        if structure.joined[k] and kind is not None:
            # what came before may be something else, and the object begin with a hit that is not seen before
            before = chances[k - 1] + (1 - chances[k - 1]) * UNSEEN_START * (kind == "hit")
            chance = before * chances[k]
            events.append(_build_event(kind, block, p, start, flights[-1], sport, chance))
            if kind == "landing":
                break
        to_fixed = np.eye(PARAMETER_COUNT, PARAMETER_COUNT + 1)
        at_start = fly(p, np.zeros(1), structure.turn_length(k, sport))
        to_fixed[:6, -1] = -np.concatenate([p[3:6], at_start.accelerations[0]])
        flights.append(Flight(start, end, p, to_fixed @ block @ to_fixed.T, turns_over(kind), chi2[k]))
        if not structure.joined[k] and kind in (None, "hit"):
            event = _build_first_hit(scene, flights[-1], rally, interval)
            events += [replace(event, probability=event.probability * chances[k])] if event is not None else []
    events = _drop_tosses(flights, _drop_unknown_bounce(events, sight, fit), sport)
    last_seen = float(sight.observed.t[np.searchsorted(sight.observed.t, flights[-1].end + 1e-9) - 1])
    landing = _finish(flights, events, sport, last_seen, interval, float(t[-1]))
    if landing is not None:
        is_seen = landing.is_seen and bool(landing.t <= t[-1])
        landing = replace(landing, weight=landing.weight * chances[len(flights) - 1], is_seen=is_seen)
    nothing = 1.0 if landing is None else 1 - landing.weight
    landings = () if landing is None else (landing,)
    return replace(rally, flights=tuple(flights), events=tuple(events), landings=landings, no_landing=nothing)


def weigh_flights(candidates: BallCandidates, sight: Sight, fit: RallyFit, used: BoolArray) -> list[float]:
    """Compute the probability of each flight that any of the places it explains shows the object, by their looks.

    A path through things that look like nothing may be smooth by chance, or because a limb moves smoothly. One thing
    looks alike wherever it is seen, so that a flight has no more independent looks than the fewest that are judged. A
    flight of fewer places, such as a service before it bounces, cannot be told by looks, and is as probable as its
    neighbours.
    """
    score = candidates.score[sight.chosen[sight.rows]]
    chances = []
    for rows in assign_times(sight.observed.t, fit.structure, fit.values):
        if len(rows) < _JUDGED_PLACES:
            chances.append(1.0)
            continue
        chances.append(weigh_looks(score[rows[used[rows]]]))
    return chances


def weigh_looks(scores: FloatArray) -> float:
    """Compute the probability that any of places with scores (N,) shows the object; 0 without places."""
    return float(1 - (1 - scores.mean()) ** _JUDGED_PLACES) if len(scores) else 0.0


def _fill_places(
    scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray, sight: Sight, used: BoolArray
) -> Rally:
    """Build a rally that has places in the image only."""
    px = np.full((len(t), 2), np.nan)
    sigma, streak, is_used = px.copy(), px.copy(), np.zeros(len(t), np.bool_)
    at = sight.chosen[sight.rows]
    px[sight.rows], streak[sight.rows] = candidates.centre[at], candidates.streak[at]
    sigma[sight.rows] = np.stack([candidates.sigma[at], candidates.sigma_along[at]], axis=1)
    is_used[sight.rows] = used
    return Rally(scene, frame, t, px, sigma, streak, is_used, (), (), players=candidates.players)


def _build_event(
    kind: RallyEventKind, block: FloatArray, p: FloatArray, start: float, before: Flight, sport: Sport, chance: float
) -> RallyEvent:
    """Build the event between two flights, which are both of the object with the probability `chance`.

    `block` (12, 12) is the covariance of the second flight and of its start.
    """
    if kind == "hit":
        velocity, spread = p[3:6], block[3:6, 3:6]
    else:
        path = fly_flight(before, np.array([start]), sport.object)
        velocity, by = path.states[0, 3:], path.derivatives[0, 3:]
        spread = by @ before.covariance @ by.T
    speed = float(np.linalg.norm(velocity))
    along = velocity / max(speed, 1e-9)
    return RallyEvent(
        kind,
        start,
        float(np.sqrt(block[-1, -1])),
        p[:3].copy(),
        block[:3, :3].copy(),
        chance * (LOW_HIT if kind == "hit" and is_low(p[:3], float(np.sqrt(block[2, 2])), sport) else 1.0),
        speed,
        float(np.sqrt(along @ spread @ along)),
        name_player(p[:3], sport) if kind == "hit" else "",
    )


def is_low(place: FloatArray, sigma: float, sport: Sport) -> bool:
    """Check whether a hit is so near the floor or the table that it may be a bounce."""
    levels = [0.0, sport.floor] if is_on_surface(place[:2], sport) else [sport.floor]
    return any(abs(place[2] - level - sport.object.radius) < 4 * sigma + _LOW_HEIGHT for level in levels)


def name_player(place: FloatArray, sport: Sport) -> str:
    """Name the player of a hit at a place (3,), m, by the half of the court."""
    return sport.halves[int(place[0] > sport.length / 2)]


def _build_first_hit(scene: CourtScene, flight: Flight, rally: Rally, interval: float) -> RallyEvent | None:
    """Build the hit that begins a flight before which no flight is seen; None where the object may come from elsewhere.

    It may come from outside the image, or have been in flight when the clip began. Where it was seen in a hand shortly
    before, the flight begins where its path comes nearest to that place.
    """
    sport, camera, t = scene.sport, scene.camera, rally.t
    row = int(np.searchsorted(t, flight.start - 1e-9))
    if row < 2:
        return None
    earlier = np.flatnonzero(np.isfinite(rally.px[:row, 0]) & (t[:row] > flight.start - _HAND_GAP))
    since = float(t[earlier[-1]]) if len(earlier) else float(t[row - 1])
    times = np.linspace(since, flight.start, 21)
    states = fly(flight.parameters, times - flight.start, 0.0).states
    back, spread = (flight.start - since) / 2, (flight.start - since) / np.sqrt(12)
    px = camera.to_pixels(states[:, :3], rally.frame[row])
    if len(earlier):
        off = np.linalg.norm(px - rally.px[earlier[-1]], axis=1)
        best = int(np.argmin(np.where(np.isfinite(off), off, np.inf)))
        back, spread = flight.start - times[best], max(spread / 3, interval / 10)
    hit = build_hit(flight, float(back), float(spread), UNSEEN_START, sport)
    inside = ((px[0] >= 0) & (px[0] <= [camera.width_px, camera.height_px])).all()
    height = hit.place[2] - sport.floor
    return hit if inside and height <= sport.reach + 2 * float(np.sqrt(flight.covariance[2, 2])) else None


def build_hit(flight: Flight, back: float, spread: float, probability: float, sport: Sport) -> RallyEvent:
    """Build the hit from which a flight came a time `back`, s, before its start; `spread`, s, is the error of that."""
    path = fly(flight.parameters, np.array([-back]), 0.0)
    by, velocity = path.derivatives[0], path.states[0, 3:]
    speed = float(np.linalg.norm(velocity))
    along = velocity / max(speed, 1e-9)
    covariance = by @ flight.covariance @ by.T
    slowing = flight.parameters[6] * speed**2 * spread
    return RallyEvent(
        "hit",
        flight.start - back,
        spread,
        path.states[0, :3].copy(),
        covariance[:3, :3] + np.outer(velocity, velocity) * spread**2,
        probability,
        speed,
        float(np.hypot(np.sqrt(along @ covariance[3:, 3:] @ along), slowing)),
        name_player(path.states[0, :3], sport),
    )


def find_last_player(events: list[RallyEvent]) -> tuple[str, float]:
    """Find who hit last, and the probability of it, from events of which the rules may allow one alone."""
    hits = sorted((one for one in events if one.kind == "hit"), key=lambda one: -one.t)
    own = list(takewhile(lambda one: one.player == hits[0].player, hits))
    return (own[0].player, 1 - prod(1 - one.probability for one in own)) if own else ("", 0.0)


def _drop_unknown_bounce(events: list[RallyEvent], sight: Sight, fit: RallyFit) -> list[RallyEvent]:
    """Leave out a bounce before which the clip shows too little, and nobody marked it: a hand may have thrown it up."""
    if not events or events[0].kind != "bounce" or not fit.structure.joined[1]:
        return events
    bounce, places = events[0], assign_times(sight.observed.t, fit.structure, fit.values)[0]
    is_marked = any(one.is_there and one.kind == "bounce" and one.is_near(bounce.t) for one in sight.observed.marks)
    return events if is_marked or len(places) >= _LEAST_BEFORE_BOUNCE else events[1:]


def _drop_tosses(flights: list[Flight], events: list[RallyEvent], sport: Sport) -> list[RallyEvent]:
    """Leave out the first hits while they drive the object nowhere: a hand throws it up, or carries it."""
    while len(events) > 1 and events[0].kind == "hit" and events[1].kind == "hit":
        crosses = (events[0].place[0] > sport.length / 2) != (events[1].place[0] > sport.length / 2)
        if crosses or abs(events[1].place[0] - events[0].place[0]) > _TOSS_SHARE * sport.length:
            break
        events = events[1:]
    return events


def _finish(
    flights: list[Flight], events: list[RallyEvent], sport: Sport, last_seen: float, interval: float, clip_end: float
) -> LandingHypothesis | None:
    """Add the contact with the ground that ends the last flight, and return the landing of the rally."""
    has_landed = bool(events) and events[-1].kind == "landing"
    contact = None if has_landed else predict_landing(flights[-1], sport, last_seen, interval)
    within = 0.0 if contact is None else contact.weight * float(ndtr((clip_end - contact.t) / contact.t_sigma))
    if contact is not None and within > 0.5:
        flight = flights[-1]
        path = fly_flight(flight, np.array([contact.t]), sport.object)
        velocity, by = path.states[0, 3:], path.derivatives[0, 3:]
        speed = float(np.linalg.norm(velocity))
        spread = float(np.sqrt(velocity @ by @ flight.covariance @ by.T @ velocity)) / max(speed, 1e-9)
        events.append(
            RallyEvent(
                name_contact(sport), contact.t, contact.t_sigma, contact.place, contact.covariance, within,
                speed, spread,
            )
        )  # fmt: skip
        flights[-1] = replace(flight, end=max(contact.t, flight.end))
    return find_landing(tuple(flights), tuple(events), sport, last_seen, interval)
