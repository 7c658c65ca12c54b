"""What a view allows: the least error of a landing place by the Cramer-Rao bound.

Two flights meet where the object touches the ground: the last one before, and the one after. Unknown are the state at
the start of the first, the velocity after the touch, drag, lift of each flight, and the drag of a turn-over, the last
three with what is known of them before. Each frame that shows the object gives two coordinates with a noise of 0.7 px;
the camera is exact. Flights before that add nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.court_cases.court_clips import CourtTruth
from models.core.court import Sport
from models.core.typing import FloatArray

NOISE_PX = 0.7
STEP = 2e-3
# Differences of place (3), m, velocity (3), m/s, drag, lift (3), 1/m, and turn-over drag.
DIFFERENCES = np.array([1e-4] * 3 + [1e-3] * 3 + [1e-4] + [1e-4] * 3 + [1e-3])
# Unknowns: the flight before (11), then velocity and lift (6) of the flight after.
UNKNOWNS = 17
# m by which the law of the flight may miss the simulated path where it is fitted to it.
LAW_ERROR = 0.01


def bound_landing(truth: CourtTruth) -> FloatArray | None:
    """Return the covariance (2, 2), m^2, of the best estimate of the landing place; None without a last flight."""
    stated, columns, sport = truth.stated, truth.columns, truth.scene.sport
    landing = next((e for e in stated["events"] if e["kind"] == "landing"), None)
    earlier = [e for e in stated["events"] if landing and e["t"] < landing["t"] - 1e-6]
    if landing is None or not earlier:
        return None
    begin, touch, thing = earlier[-1], landing["t"], sport.object
    later = [e["t"] for e in stated["events"] if e["t"] > touch + 1e-6]
    with np.load(truth.folder / "rally" / "0000.npz") as rally:
        rows = [int(np.searchsorted(rally["t"], moment + stated["start"])) for moment in (begin["t"], touch)]
        clock, places, speeds = rally["t"] - stated["start"], rally["xyz"], rally["v"]
    is_hit = begin["kind"] == "hit" and thing.turn_drag.mean > 0
    prior = np.zeros(UNKNOWNS)
    prior[6], prior[10] = thing.drag.sigma**-2, ((thing.turn_drag.sigma if is_hit else 0.0) or 1e-6) ** -2
    prior[7:10] = prior[14:] = (thing.lift or 1e-6) ** -2
    first = np.concatenate(
        [places[rows[0] + 1], speeds[rows[0] + 1], [thing.drag.mean, 0, 0, 0, thing.turn_drag.mean * is_hit]]
    )
    start = float(clock[rows[0] + 1])
    samples = np.unique(np.linspace(rows[0] + 1, rows[1] - 1, 40).astype(int))
    p = _fit_flight(first, clock[samples] - start, places[samples], prior[:11], sport)
    on_ground, by_touch = _derive_landing(p, touch - start, sport)
    information = np.diag(prior)
    t, is_visible = columns["t"], columns["is_visible"].astype(bool)
    seen = np.flatnonzero(is_visible & (t > start) & (t < touch))
    if len(seen):
        slope, _ = _differentiate(p, t[seen] - start, truth, seen)
        information[:11, :11] += slope.T @ slope / NOISE_PX**2
    seen = np.flatnonzero(is_visible & (t > touch) & (t < (later[0] if later else np.inf)))
    if len(seen):
        after = np.concatenate([places[rows[1]], speeds[min(rows[1] + 1, len(speeds) - 1)], p[6:7], np.zeros(4)])
        slope, by_time = _differentiate(after, t[seen] - touch, truth, seen)
        joint = np.zeros((len(slope), UNKNOWNS))
        joint[:, :11] = slope[:, :2] @ on_ground - np.outer(by_time, by_touch)
        joint[:, 6] += slope[:, 6]
        joint[:, 11:14], joint[:, 14:] = slope[:, 3:6], slope[:, 7:10]
        information += joint.T @ joint / NOISE_PX**2
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    inverse = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    return np.asarray(on_ground @ inverse[:11, :11] @ on_ground.T)


def _fit_flight(first: FloatArray, t: FloatArray, xyz: FloatArray, prior: FloatArray, sport: Sport) -> FloatArray:
    """Fit the law of the bound to a simulated path, so that its derivatives are those along that path."""

    def residual(p: FloatArray) -> FloatArray:
        off = (_fly(p[None], t, sport)[0][:, 0] - xyz) / LAW_ERROR
        return np.concatenate([off.ravel(), np.sqrt(prior[6:]) * (p - first)[6:]])

    return np.asarray(least_squares(residual, first, x_scale=np.maximum(np.abs(first), 0.05), max_nfev=15).x)


def _derive_landing(p: FloatArray, touch: float, sport: Sport) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the landing place (2, 11) and of its time (11,) by the parameters."""
    n = len(p)
    trials = np.concatenate([p + np.diag(DIFFERENCES), p - np.diag(DIFFERENCES), [p]])
    places, v = (a[0] for a in _fly(trials, np.array([touch]), sport))
    change = (places[:n] - places[n : 2 * n]).T / (2 * DIFFERENCES)
    by_time = -change[2] / v[-1, 2]
    return change[:2] + np.outer(v[-1, :2], by_time), by_time


def _differentiate(
    p: FloatArray, t: FloatArray, truth: CourtTruth, frames: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return the derivatives (2 K, 11) of pixels at t (K,), s after the start, by the parameters, and (2 K,) by t."""
    n = len(p)
    trials = np.concatenate([p + np.diag(DIFFERENCES), p - np.diag(DIFFERENCES), [p]])
    places, v = _fly(trials, t, truth.scene.sport)
    camera, dt = truth.scene.camera, 1e-4
    px = camera.to_pixels(places, frames[:, None])
    slope = (px[:, :n] - px[:, n : 2 * n]) / (2 * DIFFERENCES[:, None])
    ahead = camera.to_pixels(places[:, -1] + dt * v[:, -1], frames)
    return slope.transpose(0, 2, 1).reshape(-1, n), ((ahead - px[:, -1]) / dt).reshape(-1)


def _fly(p: FloatArray, t: FloatArray, sport: Sport) -> tuple[FloatArray, FloatArray]:
    """Fly N parameter vectors (N, 11) to times t (K,), s after the start; places and velocities (K, N, 3)."""
    x, v, h = p[:, :3].copy(), p[:, 3:6].copy(), STEP

    def pull(now: float, v: FloatArray) -> FloatArray:
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        drag = p[:, 6:7] * (1 + p[:, 10:11] * np.exp(-now / sport.object.turn_time))
        return np.asarray(-drag * speed * v + speed * np.cross(p[:, 7:10], v) - np.array([0, 0, 9.81]))

    grid = h * np.arange(int(t.max() / h) + 3)
    path = np.empty((len(grid), 2, *x.shape))
    for i, now in enumerate(grid):
        path[i] = x, v
        a = pull(now, v)
        b = pull(now + h / 2, v + h / 2 * a)
        c = pull(now + h / 2, v + h / 2 * b)
        d = pull(now + h, v + h * c)
        x = x + h * v + h**2 / 6 * (a + b + c)
        v = v + h / 6 * (a + 2 * b + 2 * c + d)
    at = t / h
    low = at.astype(int)
    share = (at - low)[:, None, None, None]
    both = path[low] * (1 - share) + path[low + 1] * share
    return both[:, 0], both[:, 1]
