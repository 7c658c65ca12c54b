"""Prediction of all balls over one frame interval: straight on, off a cushion, or off each other.

Tracking calls this once per frame and hypothesis, so it is rough on purpose: no spin, one restitution for every
contact, and a constant velocity between contacts. The prediction variance covers the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Table
from models.core.typing import FloatArray

BALL_RESTITUTION = 0.95
"""Ball against ball, 0.92 to 0.98 (Alciatore, TP A-6)."""
CUSHION_RESTITUTION = 0.8
"""0.75 to 0.98 by law and speed (Mathavan, Jackson, Parkin 2010)."""
ROLLING_DECELERATION = 0.15
"""m/s^2, of a ball that rolls freely."""
MAX_CONTACTS = 250
"""Per interval: a break has about 100; beyond, the balls are jammed and the rest of the interval is straight."""
_JAW_RADII = 2.6
"""Ball radii from a pocket's centre within which there is no cushion."""


@dataclass(frozen=True, slots=True)
class MotionPrediction:
    """Predicted states of N balls one frame interval later."""

    free: FloatArray
    """(N, 2) m, without any contact."""
    free_v: FloatArray
    """(N, 2) m/s."""
    xy: FloatArray
    """(N, 2) m, after contacts with cushions and balls."""
    v: FloatArray
    """(N, 2) m/s."""
    velocity_change: FloatArray
    """(N,) m/s, sum of the velocity changes; 0 without a contact."""
    contact_count: NDArray[np.int64]
    """(N,) number of contacts with cushions and balls."""
    time_since_contact: FloatArray
    """(N,) s from the contacts to the end of the interval, weighted by the velocity changes."""


def predict_motion(
    xy: FloatArray, v: FloatArray, dt: float, table: Table, solid: NDArray[np.bool_]
) -> MotionPrediction:
    """Predict balls at xy (N, 2) m with v (N, 2) m/s over dt s; only `solid` (N,) ones collide with each other."""
    speed = np.hypot(v[:, 0], v[:, 1])
    speed_ratio = np.clip(1.0 - ROLLING_DECELERATION * dt / np.maximum(speed, 1e-9), 0.0, 1.0)[:, None]
    mean_v = v * (1.0 + speed_ratio) / 2
    free, free_v = xy + mean_v * dt, v * speed_ratio
    x, w = xy.copy(), mean_v.copy()
    velocity_change, time_since_contact, contact_count = np.zeros(len(x)), np.zeros(len(x)), np.zeros(len(x), np.int64)
    time_left = dt
    for _ in range(MAX_CONTACTS):
        pair_t, a, b = _next_ball_contact(x, w, table.ball_radius, solid, time_left)
        cushion_t, c, axis = _next_cushion_contact(x, w, table, time_left)
        step = min(pair_t, cushion_t, time_left)
        x += w * step
        time_left -= step
        if min(pair_t, cushion_t) > time_left + step or time_left + step <= 0:
            break
        if pair_t <= cushion_t:
            change = _collide_balls(x, w, a, b)
            velocity_change[[a, b]] += change
            time_since_contact[[a, b]] += change * time_left
            contact_count[[a, b]] += 1
        else:
            change = abs(w[c, axis]) * (1 + CUSHION_RESTITUTION)
            velocity_change[c] += change
            time_since_contact[c] += change * time_left
            w[c, axis] *= -CUSHION_RESTITUTION
            contact_count[c] += 1
    else:
        x += w * time_left
    has_contact = (contact_count > 0)[:, None]
    time_since_contact = time_since_contact / np.maximum(velocity_change, 1e-12)
    return MotionPrediction(
        free,
        free_v,
        np.where(has_contact, x, free),
        np.where(has_contact, w, free_v),
        velocity_change,
        contact_count,
        time_since_contact,
    )


def _next_ball_contact(
    x: FloatArray, v: FloatArray, radius: float, solid: NDArray[np.bool_], horizon: float
) -> tuple[float, int, int]:
    """Find the time to the next contact of two balls, and which; infinite if there is none before the horizon."""
    moving = np.flatnonzero(solid & ((v != 0).any(axis=1)))
    others = np.flatnonzero(solid)
    if not len(moving) or len(others) < 2:
        return np.inf, 0, 0
    d = x[others][None] - x[moving][:, None]  # (M, S, 2)
    u = v[others][None] - v[moving][:, None]
    du = (d * u).sum(axis=2)
    uu = (u * u).sum(axis=2)
    excess = np.maximum((d * d).sum(axis=2) - 4 * radius**2, 0.0)
    root = du**2 - uu * excess
    hit = (du < -1e-9) & (root >= 0) & (moving[:, None] != others[None])
    if not hit.any():
        return np.inf, 0, 0
    time = np.where(hit, excess / np.where(hit, -du + np.sqrt(np.maximum(root, 0)), 1.0), np.inf)
    best = int(np.argmin(time))
    first = float(time.flat[best])
    i, j = divmod(best, len(others))
    return (first if first <= horizon else np.inf), int(moving[i]), int(others[j])


def _next_cushion_contact(x: FloatArray, v: FloatArray, table: Table, horizon: float) -> tuple[float, int, int]:
    """Find the time to the next cushion contact, the ball and the axis; infinite if there is none."""
    r = table.ball_radius
    low, high = np.full(2, r), np.array([table.length - r, table.width - r])
    wall = np.where(v > 0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(v != 0, np.maximum((wall - x) / v, 0.0), np.inf)  # (N, 2)
    time[np.isnan(time)] = np.inf
    if table.pockets and np.any(time <= horizon):
        for ball, axis in np.argwhere(time <= horizon):
            place = x[ball] + v[ball] * time[ball, axis]
            if np.min(np.hypot(*(table.pocket_centres - place).T)) < _JAW_RADII * r:
                time[ball, axis] = np.inf
    best = int(np.argmin(time)) if time.size else 0
    first = float(time.flat[best]) if time.size else np.inf
    ball, axis = divmod(best, 2)
    return (first if first <= horizon else np.inf), ball, axis


def _collide_balls(x: FloatArray, v: FloatArray, a: int, b: int) -> float:
    """Exchange the velocity of two equal masses along their line of centres; return the change of either, m/s."""
    normal = x[b] - x[a]
    normal = normal / max(float(np.hypot(*normal)), 1e-12)
    change = (1 + BALL_RESTITUTION) / 2 * float((v[a] - v[b]) @ normal)
    v[a] -= change * normal
    v[b] += change * normal
    return abs(change)
