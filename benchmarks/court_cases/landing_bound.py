"""What a view allows: the least error of a landing place by the Cramer-Rao bound.

Two flights meet where the object touches the ground: the last one before, and the one after. Unknown are place and
moment of the touch, both velocities, the drag, the lift of each flight and the drag of a turn-over, the last three with
what is known of them before. Each frame that shows the object gives two coordinates with a noise of 0.7 px; the camera
is exact. Where the flight before began, and flights before that, add nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.court_cases.court_clips import CourtTruth
from models.core.court import Sport
from models.core.typing import FloatArray

NOISE_PX = 0.7
STEP = 2e-3
# Differences of place (3), m, velocity (3), m/s, drag, lift (3), 1/m, and turn-over drag.
DIFFERENCES = np.array([1e-4] * 3 + [1e-3] * 3 + [1e-4] + [1e-4] * 3 + [1e-3])
# Columns of the information: x, y, t, velocity before, velocity after, drag, lift before, lift after, turn-over.
UNKNOWNS = 17
BEFORE = {0: 0, 1: 1, 3: 3, 4: 4, 5: 5, 6: 9, 7: 10, 8: 11, 9: 12, 10: 16}
AFTER = {0: 0, 1: 1, 3: 6, 4: 7, 5: 8, 6: 9, 7: 13, 8: 14, 9: 15}


def bound_landing(truth: CourtTruth) -> FloatArray | None:
    """Return the covariance (2, 2), m^2, of the best estimate of the landing place; None without a last flight."""
    stated, columns, sport = truth.stated, truth.columns, truth.scene.sport
    landing = next((e for e in stated["events"] if e["kind"] == "landing"), None)
    earlier = [e for e in stated["events"] if landing and e["t"] < landing["t"] - 1e-6]
    if landing is None or not earlier:
        return None
    begin, touch = earlier[-1], landing["t"]
    later = [e["t"] for e in stated["events"] if e["t"] > touch + 1e-6]
    with np.load(truth.folder / "rally" / "0000.npz") as rally:
        row = int(np.searchsorted(rally["t"], touch + stated["start"]))
        v_before, v_after, xy = rally["v"][row - 1], rally["v"][min(row + 1, len(rally["v"]) - 1)], rally["xyz"][row, :2]
    thing, z = sport.object, landing["place"][2] + sport.object.radius
    turn = thing.turn_drag.mean if begin["kind"] == "hit" else 0.0
    prior = np.zeros(UNKNOWNS)
    prior[9], prior[10:16] = thing.drag.sigma**-2, (thing.lift or 1e-6) ** -2
    prior[16] = (thing.turn_drag.sigma or 1e-6) ** -2
    information = np.diag(prior)
    t, is_visible = columns["t"], columns["is_visible"].astype(bool)
    for v, first, last, places, tail in (
        (v_before, begin["t"], touch, BEFORE, turn), (v_after, touch, later[0] if later else t[-1] + 1, AFTER, 0.0),
    ):  # fmt: skip
        seen = np.flatnonzero(is_visible & (t > first) & (t < last))
        if not len(seen):
            continue
        p = np.concatenate([xy, [z], v, [thing.drag.mean], np.zeros(3), [tail]])
        slope, by_time = _differentiate(p, t[seen] - touch, touch - first, truth, seen)
        columns_of = np.zeros((2 * len(seen), UNKNOWNS))
        columns_of[:, list(places.values())] = slope[:, list(places)]
        columns_of[:, 2] = -by_time
        information += columns_of.T @ columns_of / NOISE_PX**2
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    inverse = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    return np.asarray(inverse[:2, :2])


def _differentiate(
    p: FloatArray, t: FloatArray, since: float, truth: CourtTruth, frames: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return the derivatives (2 K, 11) of pixels at t (K,), s after the touch, by the parameters, and (2 K,) by t."""
    n = len(p)
    trials = np.concatenate([p + np.diag(DIFFERENCES), p - np.diag(DIFFERENCES), [p]])
    places, v = _fly(trials, t, since, truth.scene.sport)
    camera, dt = truth.scene.camera, 1e-4
    px = camera.to_pixels(places, frames[:, None])
    slope = (px[:, :n] - px[:, n : 2 * n]) / (2 * DIFFERENCES[:, None])
    ahead = camera.to_pixels(places[:, -1] + dt * v[:, -1], frames)
    return slope.transpose(0, 2, 1).reshape(-1, n), ((ahead - px[:, -1]) / dt).reshape(-1)


def _fly(p: FloatArray, t: FloatArray, since: float, sport: Sport) -> tuple[FloatArray, FloatArray]:
    """Fly N parameter vectors (N, 11) to times t (K,), s, all before or all after 0; places and velocities (K, N, 3)."""
    x, v, sign = p[:, :3].copy(), p[:, 3:6].copy(), 1.0 if t[0] > 0 else -1.0
    h = sign * STEP

    def pull(now: float, v: FloatArray) -> FloatArray:
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        drag = p[:, 6:7] * (1 + p[:, 10:11] * np.exp(-max(now + since, 0.0) / sport.object.turn_time))
        return np.asarray(-drag * speed * v + speed * np.cross(p[:, 7:10], v) - np.array([0, 0, 9.81]))

    grid = h * np.arange(int(np.abs(t).max() / STEP) + 3)
    path = np.empty((len(grid), 2, *x.shape))
    for i, now in enumerate(grid):
        path[i] = x, v
        a = pull(now, v)
        b = pull(now + h / 2, v + h / 2 * a)
        c = pull(now + h / 2, v + h / 2 * b)
        d = pull(now + h, v + h * c)
        x = x + h * v + h**2 / 6 * (a + b + c)
        v = v + h / 6 * (a + 2 * b + 2 * c + d)
    at = np.abs(t) / STEP
    low = at.astype(int)
    share = (at - low)[:, None, None, None]
    both = path[low] * (1 - share) + path[low + 1] * share
    return both[:, 0], both[:, 1]
