"""Where balls go within one picture interval: straight on, off a cushion, or off each other.

Association asks this once per picture and hypothesis, so it is rough on purpose: no spin, one restitution for every
contact, and a velocity that does not change between contacts. What it leaves out goes into its uncertainty.
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
MOST_CONTACTS = 250
"""per interval: a break has about 100; beyond, the balls are jammed and the rest of the interval is straight."""
_JAWS = 2.6
"""ball radii from a pocket's centre within which there is no cushion."""


@dataclass(frozen=True, slots=True)
class Foresight:
    """N balls one interval later."""

    free: FloatArray
    """(N, 2) m, as if nothing stood in the way."""
    free_v: FloatArray
    """(N, 2) m/s."""
    xy: FloatArray
    """(N, 2) m, after cushions and contacts."""
    v: FloatArray
    """(N, 2) m/s."""
    kick: FloatArray
    """(N,) m/s, sum of the velocity changes; 0 where the ball met nothing."""
    contacts: NDArray[np.int64]
    """(N,) how many cushions and balls it met."""
    since: FloatArray
    """(N,) s from there to the end of the interval, weighted by the velocity changes."""


def foresee(xy: FloatArray, v: FloatArray, dt: float, table: Table, solid: NDArray[np.bool_]) -> Foresight:
    """Move balls at xy (N, 2) m with v (N, 2) m/s by dt seconds; only `solid` (N,) ones meet each other."""
    speed = np.hypot(v[:, 0], v[:, 1])
    keep = np.clip(1.0 - ROLLING_DECELERATION * dt / np.maximum(speed, 1e-9), 0.0, 1.0)[:, None]
    mean_v = v * (1.0 + keep) / 2
    free, free_v = xy + mean_v * dt, v * keep
    x, w = xy.copy(), mean_v.copy()
    kick, since, contacts = np.zeros(len(x)), np.zeros(len(x)), np.zeros(len(x), np.int64)
    left = dt
    for _ in range(MOST_CONTACTS):
        pair_t, a, b = _next_ball(x, w, table.ball_radius, solid, left)
        rail_t, c, axis = _next_cushion(x, w, table, left)
        step = min(pair_t, rail_t, left)
        x += w * step
        left -= step
        if min(pair_t, rail_t) > left + step or left + step <= 0:
            break
        if pair_t <= rail_t:
            change = _bounce(x, w, a, b)
            kick[[a, b]] += change
            since[[a, b]] += change * left
            contacts[[a, b]] += 1
        else:
            change = abs(w[c, axis]) * (1 + CUSHION_RESTITUTION)
            kick[c] += change
            since[c] += change * left
            w[c, axis] *= -CUSHION_RESTITUTION
            contacts[c] += 1
    else:
        x += w * left
    met = (contacts > 0)[:, None]
    since = since / np.maximum(kick, 1e-12)
    return Foresight(free, free_v, np.where(met, x, free), np.where(met, w, free_v), kick, contacts, since)


def _next_ball(
    x: FloatArray, v: FloatArray, radius: float, solid: NDArray[np.bool_], horizon: float
) -> tuple[float, int, int]:
    """Time to the next contact of two balls, and which; infinite if there is none before the horizon."""
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


def _next_cushion(x: FloatArray, v: FloatArray, table: Table, horizon: float) -> tuple[float, int, int]:
    """Time to the next cushion contact, which ball, and along which axis; infinite if none."""
    r = table.ball_radius
    low, high = np.full(2, r), np.array([table.length - r, table.width - r])
    wall = np.where(v > 0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(v != 0, np.maximum((wall - x) / v, 0.0), np.inf)  # (N, 2)
    time[np.isnan(time)] = np.inf
    if table.pockets and np.any(time <= horizon):
        for ball, axis in np.argwhere(time <= horizon):
            place = x[ball] + v[ball] * time[ball, axis]
            if np.min(np.hypot(*(table.pocket_centres - place).T)) < _JAWS * r:
                time[ball, axis] = np.inf
    best = int(np.argmin(time)) if time.size else 0
    first = float(time.flat[best]) if time.size else np.inf
    ball, axis = divmod(best, 2)
    return (first if first <= horizon else np.inf), ball, axis


def _bounce(x: FloatArray, v: FloatArray, a: int, b: int) -> float:
    """Two equal masses exchange the velocity along their line of centres; the change of either, m/s."""
    normal = x[b] - x[a]
    normal = normal / max(float(np.hypot(*normal)), 1e-12)
    change = (1 + BALL_RESTITUTION) / 2 * float((v[a] - v[b]) @ normal)
    v[a] -= change * normal
    v[b] += change * normal
    return abs(change)
