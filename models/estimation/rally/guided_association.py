"""Candidates chosen anew where fitted flights say that the object is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.court_camera import CourtScene
from models.core.rally import BallCandidates
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.flight_fit import RallyFit, assign_times, flight_slice, start_row
from models.estimation.rally.flight_observations import (
    EventMark,
    FlightObservations,
    compare_places,
    find_rests,
    prepare_observations,
    stabilize_places,
)
from models.physics.flight.flight_motion import fly

# Standard deviations within which a candidate is taken for the object once the flights are known.
GATE = 4.0
# px, least error of a place that a detector may claim: pixels, compression.
LEAST_SIGMA = 0.5
# Share of the length of a streak by which its middle may err along it and across: its ends fade, and the exposure
# changes with the light. Fast balls of real rallies depart by 5 to 10 % of it from smooth paths.
_STREAK_SHARES = np.array([0.03, 0.10])


@dataclass(frozen=True, slots=True)
class Sight:
    """Which candidate shows the object in each of T frames."""

    chosen: IntArray
    """(T,) -1 for none."""
    rows: IntArray
    """(N,) frames that show it."""
    observed: FlightObservations


def look_at_candidates(
    scene: CourtScene,
    candidates: BallCandidates,
    frame: IntArray,
    t: FloatArray,
    chosen: IntArray,
    marks: tuple[EventMark, ...] = (),
    placed: FloatArray | None = None,
) -> Sight:
    """Collect the observations of the chosen candidates (T,), -1 for none, of frames (T,) at times (T,), s.

    `placed` (H,), s, are the times of the places that a person set.
    """
    rows = np.flatnonzero(chosen >= 0)
    observed = observe_candidates(scene, candidates, frame, t, chosen, rows)
    players = _locate_players(scene, candidates.players, frame, t)
    resting = find_rests(stabilize_places(scene.camera, frame[rows], candidates.centre[chosen[rows]]), t[rows])
    by_hand = np.empty(0) if placed is None else placed
    return Sight(chosen, rows, replace(observed, players=players, is_resting=resting, marks=marks, placed=by_hand))


def _locate_players(scene: CourtScene, boxes: FloatArray, frame: IntArray, t: FloatArray) -> FloatArray:
    """Find where the people (P, 5) of `BallCandidates` stand, as (P, 7) of `FlightObservations`."""
    row = np.minimum(np.searchsorted(frame, boxes[:, 0]), len(frame) - 1)
    feet = np.stack([(boxes[:, 1] + boxes[:, 3]) / 2, boxes[:, 4]], axis=1)
    place = scene.camera.to_court(feet, scene.sport.floor, frame[row])
    return np.column_stack([t[row], boxes[:, 1:], place[:, :2]])


def observe_candidates(
    scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray, chosen: IntArray, rows: IntArray
) -> FlightObservations:
    """Prepare the observations of some rows (N,) of the frames."""
    at = chosen[rows]
    claimed = np.maximum(np.stack([candidates.sigma[at], candidates.sigma_along[at]], axis=1), LEAST_SIGMA)
    length = np.linalg.norm(candidates.streak[at], axis=1)
    sigma = np.hypot(claimed, length[:, None] * _STREAK_SHARES)
    return prepare_observations(scene.camera, frame[rows], t[rows], candidates.centre[at], candidates.streak[at], sigma)


def choose_candidates(
    scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray, chosen: IntArray, fit: RallyFit
) -> IntArray:
    """Choose the candidates that fitted flights explain best.

    Args:
        scene: Court and camera.
        candidates: K candidates.
        frame: (T,) indices of the frames.
        t: (T,) s.
        chosen: (T,) candidates that were chosen before, -1 for none; they stay where no other is near the flights.
        fit: Flights.

    Returns:
        Index (T,) of the chosen candidates; -1 for none.
    """
    xyz, spread = _predict_places(scene, t, fit)
    flies = np.isfinite(xyz[:, 0])
    nothing = np.zeros((len(t), 2))
    plain = prepare_observations(scene.camera, frame, t, nothing, nothing, np.ones((len(t), 2)))
    # without a streak, "across" is y and "along" is x
    residual, by_place = compare_places(plain, np.where(flies[:, None], xyz, 0.0))
    here, by_place = (residual + plain.px[:, ::-1])[:, ::-1], by_place[:, ::-1]
    row = np.minimum(np.searchsorted(frame, candidates.frame), len(frame) - 1)
    usable = np.flatnonzero((frame[row] == candidates.frame) & flies[row])
    row = row[usable]
    off = scene.camera.undistort(candidates.centre[usable]) - here[row]
    size = np.maximum(candidates.sigma[usable], LEAST_SIGMA) ** 2
    covariance = (by_place @ spread @ by_place.transpose(0, 2, 1))[row] + np.eye(2) * size[:, None, None]
    square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
    score = np.clip(candidates.score[usable], 1e-3, 1 - 1e-3)
    value = np.where(square < GATE**2, np.log(score / (1 - score)) - 0.5 * square, -np.inf)
    order = np.argsort(value, kind="stable")  # the best of a frame is written last
    order = order[np.isfinite(value[order])]
    result = chosen.copy()
    result[row[order]] = usable[order]
    return result


def _predict_places(scene: CourtScene, t: FloatArray, fit: RallyFit) -> tuple[FloatArray, FloatArray]:
    """Predict places (T, 3), NaN where nothing flies, and their covariances (T, 3, 3)."""
    xyz, spread = np.full((len(t), 3), np.nan), np.zeros((len(t), 3, 3))
    covariance, count = fit.covariance, len(fit.structure)
    for k, rows in enumerate(assign_times(t, fit.structure, fit.values)):
        part = flight_slice(k)
        tau = t[rows] - fit.values[start_row(k, count)]
        path = fly(fit.values[part], tau, fit.structure.turn_length(k, scene.sport))
        by = path.derivatives[:, :3]
        xyz[rows], spread[rows] = path.states[:, :3], by @ covariance[part, part] @ by.transpose(0, 2, 1)
    return xyz, spread
