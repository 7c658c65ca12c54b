"""A rally of one flight whose truth is known, seen by a usual camera: no clip, detector or search is needed."""

from __future__ import annotations

import numpy as np
from support.simple_rallies import usual_view

from models.core.court import Sport
from models.core.rally import Flight, LandingHypothesis, Rally, RallyEvent, RallyEventKind
from models.core.typing import FloatArray
from models.physics.flight.flight_motion import find_descent, fly

FPS = 25.0
HIT_T = 0.4
"""s, time of the hit."""


def aim_flight(sport: Sport, target: tuple[float, float], start: tuple[float, float, float], climb: float) -> Flight:
    """Build the flight from a place to a target on the surface, m, with its first velocity up, m/s."""
    from scipy.optimize import least_squares

    item = sport.object

    def parameters(v: FloatArray) -> FloatArray:
        return np.array([*start, v[0], v[1], climb, item.drag.mean, 0, 0, 0, 0.0])

    def miss(v: FloatArray) -> FloatArray:
        fall = find_descent(parameters(v), 0.0, item.radius, 0.0, 6.0)
        return np.asarray(fly(parameters(v), np.array([fall]), 0.0).states[0, :2] - target)

    first = 1.5 * (np.array(target) - start[:2])
    found = parameters(least_squares(miss, first).x)
    fall = find_descent(found, 0.0, item.radius, 0.0, 6.0)
    covariance = np.diag(np.array([0.03, 0.03, 0.03, 0.1, 0.1, 0.1, 0.002, 1e-4, 1e-4, 1e-4, 1e-3]) ** 2)
    return Flight(HIT_T, HIT_T + fall, found, covariance, True, 1.1)


def stage_rally(
    sport: Sport,
    target: tuple[float, float],
    sigma: tuple[float, float] = (0.03, 0.02),
    start: tuple[float, float, float] | None = None,
    climb: float = 5.0,
    player: str | None = None,
    no_landing: float = 0.0,
    frames: int | None = None,
) -> Rally:
    """Build a rally of one hit that lands at a target (x, y), m, with the error sigma (x, y), m, in so many frames."""
    start = start or (0.12 * sport.length, 0.4 * sport.width, 1.0 if sport.floor == 0 else 0.25)
    flight = aim_flight(sport, target, start, climb)
    sides = sport.halves
    player = sides[int(start[0] > sport.length / 2)] if player is None else player
    scene = usual_view(sport)
    t = np.arange(frames or int((flight.end + 0.4) * FPS)) / FPS
    frame = np.arange(len(t))
    flying = (t >= flight.start) & (t <= flight.end)
    px = np.full((len(t), 2), np.nan)
    states = fly(flight.parameters, t[flying] - flight.start, 0.0).states
    px[flying] = scene.camera.to_pixels(states[:, :3])
    px[np.flatnonzero(flying)[4]] = np.nan  # hidden in one frame
    end = fly(flight.parameters, np.array([flight.end - flight.start]), 0.0).states[0]
    covariance = np.diag([sigma[0] ** 2, sigma[1] ** 2, 1e-6])
    place = np.array([*target, sport.object.radius])
    speed = float(np.linalg.norm(end[3:]))
    kind: RallyEventKind = "landing" if sport.object.restitution is None else "bounce"
    events = (
        RallyEvent("hit", flight.start, 0.004, np.array(start), np.diag([0.05, 0.05, 0.05]) ** 2, 1.0,
                   float(np.linalg.norm(flight.parameters[3:6])), 0.4, player),
        RallyEvent(kind, flight.end, 0.003, place, covariance, 1 - no_landing, speed, 0.2),
    )  # fmt: skip
    landings = (LandingHypothesis(1 - no_landing, flight.end, 0.003, place, covariance, True),)
    return Rally(
        scene, frame, t, px, np.full((len(t), 2), 0.7), np.zeros((len(t), 2)), np.isfinite(px[:, 0]), (flight,),
        events, landings, no_landing, np.empty((0, 5)),
    )  # fmt: skip
