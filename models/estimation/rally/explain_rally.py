"""From candidates to a rally: association, search over sequences of flights, joint fit, landing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.court import Sport
from models.core.court_camera import CourtCamera, CourtScene
from models.core.progress import Progress
from models.core.rally import BallCandidates, Flight, LandingHypothesis, Rally, RallyEvent
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.rally.flight_fit import (
    RallyFit,
    accelerate,
    assign_times,
    fit_rally,
    flight_slice,
    refine_fit,
    start_row,
)
from models.estimation.rally.flight_observations import (
    FlightObservations,
    bound_residuals,
    compare_places,
    prepare_observations,
    stabilize_places,
)
from models.estimation.rally.flight_segmentation import segment_rally
from models.estimation.rally.guided_association import GATE, LEAST_SIGMA, choose_candidates
from models.estimation.rally.image_association import associate_candidates
from models.estimation.rally.landing_hypotheses import find_landing, merge_landings, predict_landing
from models.estimation.rally.structure_revision import revise_structure
from models.numerics.least_squares import invert_semidefinite
from models.numerics.statistics import measure_lack_of_fit
from models.physics.flight.flight_motion import PARAMETER_COUNT, fly

# Natural logarithm of the probability that an explanation is right although another fits better by as much: evidence
# is computed from a model that is never wholly true, and so counts by half.
_EVIDENCE_SHARE = 0.5
# Natural logarithm of the evidence by which a rival may be worse, and their largest number.
_WORST_RIVAL, _MOST_RIVALS = 16.0, 8
# Natural logarithm of the density of clutter for an observation that no flight explains.
_CLUTTER_COST = 12.0
# s before the end of a clip within which a landing counts as an event of it.
_CAMERA_STEPS = np.array([0.01, 0.01, 0.01, 1e-4, 1e-4, 1e-4, 1e-4, 1e-3])
# Probability of an event that begins a rally, of which only the flight behind it is seen.
_UNSEEN_START = 0.8


@dataclass(frozen=True, slots=True)
class _Sight:
    """Which candidate shows the object in each of T frames."""

    chosen: IntArray
    """(T,) -1 for none."""
    rows: IntArray
    """(N,) frames that show it."""
    observed: FlightObservations


def explain_rally(
    scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray, progress: Progress
) -> Rally:
    """Explain the candidates of a clip as one rally.

    Args:
        scene: Court and camera.
        candidates: Candidates of all frames.
        frame: (T,) indices of the distinct frames in the file.
        t: (T,) s.
        progress: Receives the finished share.

    Returns:
        The most probable rally; without flights where nothing flies.
    """
    sport = scene.sport
    chosen = associate_candidates(scene, candidates, frame, t)
    progress(0.2)
    sight = _look(scene.camera, candidates, frame, t, chosen)
    px = stabilize_places(scene.camera, frame[sight.rows], candidates.centre[chosen[sight.rows]])
    hypotheses = segment_rally(sight.observed, px, sport, lambda share: progress(0.2 + 0.4 * share))
    fits: list[RallyFit] = []
    for k, hypothesis in enumerate(hypotheses):
        fit = fit_rally(sight.observed, sport, hypothesis)
        if fit is not None and not any(_are_same(fit, other) for other in fits):
            fits.append(fit)
        progress(0.6 + 0.3 * (k + 1) / len(hypotheses))
    if not fits:
        return _build_empty(scene, candidates, frame, t)
    fits.sort(key=lambda fit: -_weigh_fit(fit, sight.observed))
    revised = revise_structure(sight.observed, sport, fits[0], lambda fit: _weigh_fit(fit, sight.observed))
    fits = [*revised, *(fit for fit in fits[1:] if not any(_are_same(fit, other) for other in revised))]
    chosen = choose_candidates(scene, candidates, frame, t, sight.chosen, fits[0])
    if (chosen != sight.chosen).any():
        sight = _look(scene.camera, candidates, frame, t, chosen)
        refined = (refine_fit(sight.observed, sport, fit.structure, fit.values) for fit in fits)
        fits = [fit for fit in refined if fit is not None] or fits
    fits = _select_fits(fits, sight.observed)
    evidence = np.array([_weigh_fit(fit, sight.observed) for fit in fits])
    order = np.argsort(-evidence, kind="stable")
    weights = np.exp(_EVIDENCE_SHARE * (evidence[order] - evidence.max()))
    weights = weights / weights.sum()
    rallies = [_build_rally(scene, candidates, frame, t, sight, fits[k]) for k in order]
    progress(1.0)
    return _combine(rallies, weights, t)


def _select_fits(fits: list[RallyFit], observed: FlightObservations) -> list[RallyFit]:
    """Leave out explanations that occur twice, or that no longer matter."""
    best = sorted(fits, key=lambda fit: -_weigh_fit(fit, observed))
    selected: list[RallyFit] = []
    for fit in best:
        matters = _weigh_fit(fit, observed) > _weigh_fit(best[0], observed) - _WORST_RIVAL
        if matters and len(selected) < _MOST_RIVALS and not any(_are_same(fit, other) for other in selected):
            selected.append(fit)
    return selected


def _look(camera: CourtCamera, candidates: BallCandidates, frame: IntArray, t: FloatArray, chosen: IntArray) -> _Sight:
    rows = np.flatnonzero(chosen >= 0)
    return _Sight(chosen, rows, _observe(camera, candidates, frame, t, chosen, rows))


def _observe(
    camera: CourtCamera, candidates: BallCandidates, frame: IntArray, t: FloatArray, chosen: IntArray, rows: IntArray
) -> FlightObservations:
    at = chosen[rows]
    sigma = np.maximum(np.stack([candidates.sigma[at], candidates.sigma_along[at]], axis=1), LEAST_SIGMA)
    return prepare_observations(camera, frame[rows], t[rows], candidates.centre[at], candidates.streak[at], sigma)


def _are_same(one: RallyFit, other: RallyFit) -> bool:
    return (
        one.structure.kinds == other.structure.kinds
        and one.structure.joined == other.structure.joined
        and abs(one.evidence - other.evidence) < 0.5
        and bool(np.abs(one.values - other.values)[: 1 + PARAMETER_COUNT].max() < 0.05)
    )


def _weigh_fit(fit: RallyFit, observed: FlightObservations) -> float:
    """Return the evidence of a fit, the observations that it leaves as clutter included."""
    explained = sum(len(rows) for rows in assign_times(observed.t, fit.structure, fit.values))
    return fit.evidence - _CLUTTER_COST * (len(observed) - explained)


def _build_empty(scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray) -> Rally:
    nothing = np.full((len(t), 2), np.nan)
    return Rally(
        scene, frame, t, nothing, nothing, nothing, np.zeros(len(t), np.bool_), (), (),
        players=candidates.players, notes=("no-flight",),
    )  # fmt: skip


def _estimate_covariance(
    camera: CourtCamera,
    candidates: BallCandidates,
    frame: IntArray,
    t: FloatArray,
    sight: _Sight,
    fit: RallyFit,
    sport: Sport,
) -> tuple[FloatArray, list[float], BoolArray]:
    """Estimate the covariance of all values, chi2 per degree of freedom of each flight, and which places were used.

    What residuals exceed their nominal errors by raises the covariance; the errors of the camera, which all
    observations share, are added (consider covariance: Bierman 1977, section VIII.2).
    """
    structure, values, count = fit.structure, fit.values, len(fit.structure)
    rows_of = assign_times(sight.observed.t, structure, values)
    shifted = []
    for j in range(len(_CAMERA_STEPS)):
        moved = camera.parameters.copy()
        moved[j] += _CAMERA_STEPS[j]
        changed = camera.replace_parameters(moved)
        shifted.append(_observe(changed, candidates, frame, t, sight.chosen, sight.rows))
    series, chi2, pull = [], [], np.zeros((len(values), len(_CAMERA_STEPS)))
    used = np.zeros(len(sight.rows), np.bool_)
    for k, rows in enumerate(rows_of):
        part, start = flight_slice(k), values[start_row(k, count)]
        path = fly(values[part], sight.observed.t[rows] - start, structure.turn_time(k, sport))
        residual, by_place = compare_places(sight.observed.select(rows), path.states[:, :3])
        factor, slope = bound_residuals(residual)
        bounded = residual * factor[:, None]
        used[rows] = (residual**2).sum(axis=1) < GATE**2
        series.append(bounded)
        freedom = 2 * len(rows) - 6
        chi2.append(float((bounded**2).sum()) / freedom if freedom > 0 else float("nan"))
        by = np.concatenate([by_place @ path.derivatives[:, :3], -by_place @ path.states[:, 3:, None]], axis=2)
        columns = np.append(np.arange(part.start, part.stop), start_row(k, count))
        for j, other in enumerate(shifted):
            change = (compare_places(other.select(rows), path.states[:, :3])[0] - residual) / _CAMERA_STEPS[j]
            pull[columns, j] += np.einsum("nip,ni,n->p", by, change, slope**2)
    covariance = invert_semidefinite(fit.information)
    free = min(6 * count, max(sum(2 * len(rows) for rows in rows_of) - 1, 0))
    _, inflation = measure_lack_of_fit(series, free)
    moved_by = covariance @ pull
    return covariance * inflation + moved_by @ camera.covariance @ moved_by.T, chi2, used


def _build_rally(
    scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray, sight: _Sight, fit: RallyFit
) -> Rally:
    """Build the rally of one fit, with its landing."""
    sport, structure, values, count = scene.sport, fit.structure, fit.values, len(fit.structure)
    covariance, chi2, used = _estimate_covariance(scene.camera, candidates, frame, t, sight, fit, sport)
    interval = float(np.median(np.diff(t)))
    flights: list[Flight] = []
    events: list[RallyEvent] = []
    for k in range(count):
        part, at = flight_slice(k), start_row(k, count)
        p, start = values[part], float(values[at])
        is_ended = k + 1 < count and structure.joined[k + 1]
        end = float(values[at + 1]) if is_ended else float(structure.end[k])
        columns = np.append(np.arange(part.start, part.stop), at)
        block = covariance[np.ix_(columns, columns)]
        to_fixed = np.eye(PARAMETER_COUNT, PARAMETER_COUNT + 1)
        to_fixed[:6, -1] = -np.concatenate([p[3:6], accelerate(p, p[:6])])
        turns = structure.turn_time(k, sport) > 0
        flights.append(Flight(start, end, p, to_fixed @ block @ to_fixed.T, turns, chi2[k]))
        kind = structure.kinds[k]
        if structure.joined[k] and kind is not None:
            events.append(_build_event(kind, block, p, start, flights[k - 1], sport))
        else:
            event = _build_first_hit(scene, flights[-1], t, interval)
            events += [event] if event is not None else []
    last_seen = float(
        sight.observed.t[sight.rows.searchsorted(np.flatnonzero(t <= flights[-1].end + 1e-9)[-1], "right") - 1]
    )
    landing = _finish(flights, events, sport, last_seen, interval, float(t[-1]))
    seen = np.full((len(t), 2), np.nan)
    sigma, streak, is_used = seen.copy(), seen.copy(), np.zeros(len(t), np.bool_)
    at_rows = sight.chosen[sight.rows]
    seen[sight.rows], streak[sight.rows] = candidates.centre[at_rows], candidates.streak[at_rows]
    sigma[sight.rows] = np.stack([candidates.sigma[at_rows], candidates.sigma_along[at_rows]], axis=1)
    is_used[sight.rows] = used
    return Rally(
        scene, frame, t, seen, sigma, streak, is_used, tuple(flights), tuple(events),
        () if landing is None else (landing,), 1.0 if landing is None else 1 - landing.weight, candidates.players,
    )  # fmt: skip


def _build_event(kind: str, block: FloatArray, p: FloatArray, start: float, before: Flight, sport: Sport) -> RallyEvent:
    """Build the event between two flights; `block` (12, 12) is the covariance of the second one and of its start."""
    if kind == "hit":
        velocity, spread = p[3:6], block[3:6, 3:6]
    else:
        turn_time = sport.object.turn_time if before.begins_with_hit else 0.0
        path = fly(before.parameters, np.array([start - before.start]), turn_time)
        velocity, by = path.states[0, 3:], path.derivatives[0, 3:]
        spread = by @ before.covariance @ by.T
    speed = float(np.linalg.norm(velocity))
    along = velocity / max(speed, 1e-9)
    return RallyEvent(
        kind,  # type: ignore[arg-type]
        start,
        float(np.sqrt(block[-1, -1])),
        p[:3].copy(),
        block[:3, :3].copy(),
        1.0,
        speed,
        float(np.sqrt(along @ spread @ along)),
        name_player(p[:3], sport) if kind == "hit" else "",
    )


def name_player(place: FloatArray, sport: Sport) -> str:
    """Name the player of a hit at a place (3,), m, by the half of the court."""
    sides = ("left", "right") if sport.is_filmed_from_side else ("near", "far")
    return sides[int(place[0] > sport.length / 2)]


def _build_first_hit(scene: CourtScene, flight: Flight, t: FloatArray, interval: float) -> RallyEvent | None:
    """Build the hit that begins a flight before which nothing is seen; None where the object may come from elsewhere.

    It may come from outside the image, or have been in flight when the clip began.
    """
    sport, camera = scene.sport, scene.camera
    if flight.start < t[0] + 1.5 * interval:
        return None
    tau = np.array([-0.5 * interval, -2 * interval])
    path = fly(flight.parameters, tau, 0.0)
    frame = camera.first_frame + int(np.searchsorted(t, flight.start))
    before = camera.to_pixels(path.states[1, :3], frame if camera.motion is not None else None)
    inside = ((before >= 0) & (before <= [camera.width_px, camera.height_px])).all()
    height = path.states[0, 2] - sport.floor
    deviation = float(np.sqrt(flight.covariance[2, 2]))
    if not inside or height > sport.reach + 2 * deviation:
        return None
    by, speed = path.derivatives[0], float(np.linalg.norm(path.states[0, 3:]))
    along = path.states[0, 3:] / max(speed, 1e-9)
    covariance = by @ flight.covariance @ by.T
    lost = np.outer(path.states[0, 3:], path.states[0, 3:]) * interval**2 / 12
    return RallyEvent(
        "hit",
        float(flight.start + tau[0]),
        interval / float(np.sqrt(12)),
        path.states[0, :3].copy(),
        covariance[:3, :3] + lost,
        _UNSEEN_START,
        speed,
        float(np.sqrt(along @ covariance[3:, 3:] @ along)),
        name_player(path.states[0, :3], sport),
    )


def _finish(
    flights: list[Flight], events: list[RallyEvent], sport: Sport, last_seen: float, interval: float, clip_end: float
) -> LandingHypothesis | None:
    """Add the contact with the ground that ends the last flight, and return the landing of the rally."""
    contact = predict_landing(flights[-1], sport, last_seen, interval)
    if contact is not None and contact.t <= clip_end + interval and contact.weight > 0.5:
        flight = flights[-1]
        turn_time = sport.object.turn_time if flight.begins_with_hit else 0.0
        path = fly(flight.parameters, np.array([contact.t - flight.start]), turn_time)
        velocity, by = path.states[0, 3:], path.derivatives[0, 3:]
        speed = float(np.linalg.norm(velocity))
        spread = float(np.sqrt(velocity @ by @ flight.covariance @ by.T @ velocity)) / max(speed, 1e-9)
        kind = "landing" if sport.object.restitution is None else "bounce"
        events.append(
            RallyEvent(
                kind, contact.t, contact.t_sigma, contact.place, contact.covariance, contact.weight, speed, spread
            )  # type: ignore[arg-type]
        )
        flights[-1] = replace(flight, end=max(contact.t, flight.end))
    return find_landing(tuple(flights), tuple(events), sport, last_seen, interval)


def _combine(rallies: list[Rally], weights: FloatArray, t: FloatArray) -> Rally:
    """Weigh the events and the landing of the best rally by all explanations."""
    best, interval = rallies[0], float(np.median(np.diff(t)))
    events = []
    for event in best.events:
        support = sum(
            weight
            for rally, weight in zip(rallies, weights, strict=True)
            if any(other.kind == event.kind and abs(other.t - event.t) < 1.5 * interval for other in rally.events)
        )
        events.append(replace(event, probability=float(min(event.probability * support, 1.0))))
    pairs = [
        (float(weight), rally.landings[0] if rally.landings else None)
        for rally, weight in zip(rallies, weights, strict=True)
    ]
    landings, nothing = merge_landings(pairs)
    return replace(best, events=tuple(events), landings=landings, no_landing=nothing)
