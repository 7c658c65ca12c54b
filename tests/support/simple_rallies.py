"""Rallies with known truth: flights of the sport's own law between hits, bounces and a landing, seen by one camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.court import Sport
from models.core.court_camera import CourtCamera, CourtScene
from models.core.rally import BallCandidates
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.rally_views import find_surface_contact
from models.physics.flight.flight_motion import find_descent, fly


def look_at(
    centre: tuple[float, float, float],
    target: tuple[float, float, float],
    focal: float,
    is_left_handed: bool,
    sigma: float = 0.0,
    size: tuple[int, int] = (1280, 720),
) -> CourtCamera:
    """Build a camera at a place that looks at another, with the focal length in px."""
    from scipy.spatial.transform import Rotation

    turned = np.diag([1.0, -1.0 if is_left_handed else 1.0, 1.0])
    place, aim = turned @ np.array(centre), turned @ np.array(target)
    ahead = (aim - place) / np.linalg.norm(aim - place)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.array([right, np.cross(ahead, right), ahead])
    parameters = np.concatenate([centre, Rotation.from_matrix(matrix).as_rotvec(), [np.log(focal), 0.0]])
    covariance = np.diag((sigma * np.array([0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3, 3e-3, 1e-3])) ** 2 + 1e-16)
    return CourtCamera(parameters, covariance, *size, is_left_handed)


def usual_view(sport: Sport, focal: float | None = None) -> CourtScene:
    """Build the scene of a broadcast: behind the near end, or beside a table."""
    length, width = sport.length, sport.width
    if sport.is_filmed_from_side:
        camera = look_at((length / 2 - 0.4, -6.0, 2.0), (length / 2, width / 2, 0.1), focal or 1500, False)
    elif length > 20:
        camera = look_at((-18.0, width / 2 + 0.5, 8.5), (length * 0.45, width / 2, 0.5), focal or 1600, True)
    else:
        camera = look_at((-13.0, width / 2 - 0.6, 6.5), (length * 0.48, width / 2, 1.2), focal or 1500, True)
    return CourtScene(sport, camera, 0.5)


@dataclass(frozen=True, slots=True)
class TrueRally:
    """What happened: events (kind, t, place) and the object at every frame."""

    kinds: tuple[str, ...]
    t: FloatArray
    place: FloatArray
    speed: FloatArray
    frame_t: FloatArray
    xyz: FloatArray
    """(T, 3); NaN before the first event and after the end of play."""


def play_rally(sport: Sport, hits: int, rng: np.random.Generator, fps: float = 25.0) -> TrueRally:
    """Play hits back and forth with random speeds until the object lands after the last."""
    item = sport.object
    drag = item.drag.mean + item.drag.sigma * rng.standard_normal() * 0.7
    events: list[tuple[str, float, FloatArray, float]] = []
    pieces: list[tuple[float, float, FloatArray, float]] = []
    side, t = 0, 0.3
    place = np.array([0.1 * sport.length, sport.width * rng.uniform(0.3, 0.7), _hit_height(sport, rng)])
    for k in range(hits):
        parameters = _aim(sport, place, side, drag, rng, k == hits - 1)
        events.append(("hit", t, place, float(np.linalg.norm(parameters[3:6]))))
        turn = item.turn_length
        while True:
            fall = find_surface_contact(parameters, turn > 0, sport, 0.0)
            state = fly(parameters, np.array([fall]), turn).states[0]
            is_last = k == hits - 1
            if item.restitution is None:
                end = fall if is_last else _find_hit_time(sport, parameters, turn, side, rng, fall)
            elif events[-1][0] == "bounce":
                end = min(fall, rng.uniform(0.45, 0.7) * fall) if not is_last else fall
            else:
                end = fall
            pieces.append((t, end, parameters, turn))
            state = fly(parameters, np.array([end]), turn).states[0]
            t += end
            place = state[:3]
            if item.restitution is None:
                if is_last:
                    events.append(("landing", t, place, float(np.linalg.norm(state[3:]))))
                    t += _hop(pieces, t, state, drag)
                break
            if end < fall and events[-1][0] == "bounce":
                break
            events.append(("bounce", t, place, float(np.linalg.norm(state[3:]))))
            if is_last and sum(event[0] == "bounce" for event in events[-2:]) == 2:
                break
            parameters, turn = _bounce(sport, state, drag, rng), 0.0
        side = 1 - side
    frame_t = np.arange(int((t + 0.3) * fps)) / fps
    xyz = np.full((len(frame_t), 3), np.nan)
    for start, length, parameters, turn in pieces:
        rows = (frame_t >= start) & (frame_t < start + length)
        xyz[rows] = fly(parameters, frame_t[rows] - start, turn).states[:, :3]
    kinds, times, places, speeds = zip(*events, strict=True)
    return TrueRally(kinds, np.array(times), np.array(places), np.array(speeds), frame_t, xyz)


def observe_rally(
    scene: CourtScene,
    rally: TrueRally,
    rng: np.random.Generator,
    noise: float = 0.7,
    missing: float = 0.08,
    clutter: float = 2.0,
) -> BallCandidates:
    """See a rally with noise, px, a share of missing frames and a mean number of clutter candidates per frame."""
    px = scene.camera.to_pixels(rally.xyz)
    rows: list[tuple[int, float, float, float]] = []
    inside = ((px > 0) & (px < [scene.camera.width_px, scene.camera.height_px])).all(axis=1)
    for k in range(len(px)):
        if inside[k] and rng.random() > missing:
            rows.append((k, *(px[k] + noise * rng.standard_normal(2)), rng.uniform(0.5, 0.98)))
        for _ in range(rng.poisson(clutter)):
            x, y = rng.uniform(0, scene.camera.width_px), rng.uniform(0, scene.camera.height_px)
            rows.append((k, x, y, rng.uniform(0.05, 0.6)))
    table = np.array(rows)
    sigma = np.full(len(table), noise)
    return BallCandidates(
        table[:, 0].astype(np.int64), table[:, 1:3], np.zeros((len(table), 2)), table[:, 3], sigma, sigma
    )


def frames_of(rally: TrueRally) -> IntArray:
    """Return the indices (T,) of the frames."""
    return np.arange(len(rally.frame_t))


def _hit_height(sport: Sport, rng: np.random.Generator) -> float:
    if sport.floor < 0:
        return float(rng.uniform(0.1, 0.5))
    return float(rng.uniform(0.6, 2.7) if sport.object.restitution is None else rng.uniform(0.5, 1.6))


def _bounce(sport: Sport, state: FloatArray, drag: float, rng: np.random.Generator) -> FloatArray:
    item = sport.object
    assert item.restitution is not None
    assert item.retention is not None
    keep = item.retention.mean + 0.5 * item.retention.sigma * rng.standard_normal()
    up = item.restitution.mean + 0.5 * item.restitution.sigma * rng.standard_normal()
    velocity = state[3:] * [keep, keep, -up]
    return np.concatenate([state[:3], velocity, [drag], rng.standard_normal(3) * item.lift * 0.5, [0.0]])


def _hop(pieces: list[tuple[float, float, FloatArray, float]], t: float, state: FloatArray, drag: float) -> float:
    """Let a shuttle hop once where it lands at t, s; returns how long."""
    velocity = state[3:] * [0.4, 0.4, -0.2]
    pieces.append((t, 2 * velocity[2] / 9.81, np.concatenate([state[:3], velocity, [drag, 0, 0, 0, 0]]), 0.0))
    return float(2 * velocity[2] / 9.81)


def _find_hit_time(
    sport: Sport, parameters: FloatArray, turn: float, side: int, rng: np.random.Generator, fall: float
) -> float:
    """Find when a shuttle that has crossed the net is hit: at a height that a player reaches."""
    times = np.linspace(0, fall, 400)
    places = fly(parameters, times, turn).states
    beyond = (places[:, 0] > sport.length * 0.56) if side == 0 else (places[:, 0] < sport.length * 0.44)
    height = rng.uniform(0.5, 2.7)
    rows = np.flatnonzero(beyond & (places[:, 2] < height))
    return float(times[rows[0]]) if len(rows) else float(0.9 * fall)


def _aim(
    sport: Sport, place: FloatArray, side: int, drag: float, rng: np.random.Generator, is_last: bool
) -> FloatArray:
    """Choose a stroke that crosses the net and lands on the other side."""
    item, half = sport.object, sport.length / 2
    for _ in range(4000):
        heading = 1.0 if side == 0 else -1.0
        if item.restitution is None:
            speed, rise = rng.uniform(10, 75), rng.uniform(-0.35, 1.1)
        elif sport.floor < 0:
            speed, rise = rng.uniform(4, 14), rng.uniform(-0.2, 0.4)
        else:
            speed, rise = rng.uniform(14, 45), rng.uniform(-0.12, 0.3)
        turn = rng.uniform(-0.25, 0.25)
        velocity = speed * np.array([heading * np.cos(rise) * np.cos(turn), np.sin(turn) * np.cos(rise), np.sin(rise)])
        lift = rng.standard_normal(3) * item.lift * 0.5
        over = max(item.turn_drag.mean + 0.5 * item.turn_drag.sigma * rng.standard_normal(), 0.0)
        parameters = np.concatenate([place, velocity, [drag], lift, [over]])
        fall = find_descent(parameters, item.turn_length, item.radius, 0.0, 6.0, 0.05)
        if not np.isfinite(fall):
            continue
        states = fly(parameters, np.linspace(0, fall, 60), item.turn_length).states
        crossing = np.argmin(np.abs(states[:, 0] - half))
        landing = states[-1]
        margin = 0.6 if is_last else 0.0
        good = half + 0.4 * half * 0.3 < landing[0] < sport.length + margin
        if side == 1:
            good = -margin < landing[0] < half - 0.4 * half * 0.3
        if good and states[crossing, 2] > sport.net.height + 0.1 and -0.2 < landing[1] < sport.width + 0.2:
            return parameters
    raise RuntimeError("no stroke found")
