"""Motion of a ball on the cloth between two contacts, in closed form: it slides, rolls, rests.

A sliding ball feels constant friction against its slip (the velocity of the point that touches the cloth), whose
direction does not change while it slides; the path is a parabola (Marlow 1995, The Physics of Pocket Billiards).
A rolling ball slows down at mu_r g along its path. Side spin does not act on the centre.

Every formula is analytic in its inputs, so that complex numbers pass through: derivatives come from a complex step,
exact to rounding (Squire and Trapp 1998, doi:10.1137/S003614459631241X).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.numerics.jit import compiled

GRAVITY = 9.81
"""m/s^2."""

STATE = 8
"""Numbers of a span: x, y (m), vx, vy (m/s), slip ux, uy (m/s), extra acceleration while rolling cx, cy (m/s^2)."""

_TINY_SLIP = 1e-12
"""m^2/s^2 under the root of |u|: keeps the derivative finite where the ball rolls from the start."""
_STEP = 1e-30
"""of the complex step: far below rounding, since nothing is subtracted."""


@dataclass(frozen=True, slots=True)
class Friction:
    """Coefficients of the cloth, decelerations being mu g."""

    sliding: float
    rolling: float


def rolling_spin(v: FloatArray, slip: FloatArray, radius: float) -> FloatArray:
    """wx, wy (..., 2) in rad/s of a ball with velocity v (..., 2) and slip (..., 2), m/s."""
    return np.stack([slip[..., 1] - v[..., 1], v[..., 0] - slip[..., 0]], axis=-1) / radius


def slide_time(state: FloatArray, friction: Friction) -> FloatArray:
    """How long spans (..., 8) slide, s (...)."""
    time: FloatArray = 2 / 7 * np.hypot(state[..., 4], state[..., 5]) / (friction.sliding * GRAVITY)
    return time


def rest_time(state: FloatArray, friction: Friction) -> FloatArray:
    """How long spans (..., 8) take until rest, s (...)."""
    slide = slide_time(state, friction)
    _, v, _ = _roll_start(state, friction)
    speed = np.hypot(v[..., 0], v[..., 1])
    time: FloatArray = slide + speed / _deceleration(v, speed, state[..., 6:8], friction.rolling * GRAVITY)
    return time


def kinematics(state: FloatArray, tau: FloatArray, friction: Friction) -> FloatArray:
    """Position, velocity and slip (M, 6) of spans (M, 8) at times tau (M,) after their starts."""
    return np.real(_follow(state, tau, friction.sliding, friction.rolling))


def kinematics_jacobian(state: FloatArray, tau: FloatArray, friction: Friction) -> tuple[FloatArray, FloatArray]:
    """`kinematics` (M, 6), and its derivatives (M, 6, 11) by the state, tau, ln mu_sliding and ln mu_rolling."""
    value, slope = np.empty((len(tau), 6)), np.empty((len(tau), 6, STATE + 3))
    _differentiate(
        np.ascontiguousarray(state, np.float64), np.ascontiguousarray(tau, np.float64), friction.sliding,
        friction.rolling, value, slope,
    )  # fmt: skip
    return value, slope


@compiled
def _differentiate(state, tau, sliding, rolling, value, slope):  # type: ignore[no-untyped-def]
    """Fill `value` (M, 6) and `slope` (M, 6, 11) with `_follow` and its derivatives, by hand.

    Fits spend their time here. The order of the inputs is the state (8,), tau, ln mu_sliding, ln mu_rolling.
    """
    slid, ds = np.empty(7), np.empty((7, 11))  # x, v, slip where sliding ends, and the time left from there
    for row in range(len(tau)):
        differentiate_one(state[row], tau[row], sliding, rolling, slid, ds, value[row], slope[row])


@compiled
def differentiate_one(state, tau, sliding, rolling, slid, ds, value, slope):  # type: ignore[no-untyped-def]
    """One span (8,): fill `value` (6,) and `slope` (6, 11); `slid` (7,) and `ds` (7, 11) are room to work in."""
    _slide(state, tau, sliding * GRAVITY, slid, ds)
    _roll(slid, ds, state[6], state[7], rolling * GRAVITY, value, slope)


@compiled
def _slide(s, tau, a, out, d):  # type: ignore[no-untyped-def]
    """Place, velocity, slip and the time left (7,) after sliding at `a` m/s2 for tau s at most; d (7, 11)."""
    speed = np.sqrt(s[4] * s[4] + s[5] * s[5] + _TINY_SLIP)
    whole = 2 / 7 * speed / a
    ts = min(tau, whole)
    d[:] = 0.0
    out[6] = tau - ts
    for i in range(2):
        e = s[4 + i] / speed
        push = a * ts * e
        out[i], out[2 + i], out[4 + i] = s[i] + (s[2 + i] - push / 2) * ts, s[2 + i] - push, s[4 + i] - 3.5 * push
        d[i, i] = d[2 + i, 2 + i] = d[4 + i, 4 + i] = 1.0
        d[i, 2 + i] = ts
        for j in range(2):
            f = s[4 + j] / speed
            turn = ((i == j) - e * f) / speed  # of the direction of slip with the slip
            late = 2 / 7 * f / a if ts < tau else 0.0  # of ts with the slip
            dpush = a * ts * turn + a * e * late
            d[i, 4 + j] = -dpush / 2 * ts + (s[2 + i] - push / 2) * late
            d[2 + i, 4 + j] = -dpush
            d[4 + i, 4 + j] -= 3.5 * dpush
            if ts < tau:
                d[6, 4 + j] = -late
        if ts < tau:
            d[i, 9] = -(s[2 + i] - push / 2) * ts
        else:
            d[i, 8], d[2 + i, 8], d[4 + i, 8] = s[2 + i] - push, -a * e, -3.5 * a * e
            d[i, 9], d[2 + i, 9], d[4 + i, 9] = -push / 2 * ts, -push, -3.5 * push
    if ts < tau:
        d[6, 8], d[6, 9] = 1.0, ts


@compiled
def _roll(slid, ds, cx, cy, slow, out, d):  # type: ignore[no-untyped-def]
    """State (6,) after rolling at `slow` m/s2 for the time left, or until rest; d (6, 11) through `ds` (7, 11)."""
    speed = np.sqrt(slid[2] * slid[2] + slid[3] * slid[3] + _TINY_SLIP)
    hx, hy = slid[2] / speed, slid[3] / speed
    along = hx * cx + hy * cy
    braking = max(slow - along, 0.2 * slow)
    stop = speed / braking
    moves = slid[6] < stop
    t = slid[6] if moves else stop
    h, c, held = (hx, hy), (cx, cy), not moves and braking > 0.2 * slow
    out[4], out[5] = slid[4], slid[5]
    for i in range(2):
        v, a = slid[2 + i], c[i] - slow * h[i]
        out[i] = slid[i] + v * t + a * t * t / 2
        out[2 + i] = v + a * t if moves else 0.0
    for k in range(11):  # loops over numbers: whole rows would take several times as long to compile
        dt = ds[6, k]  # of t, that of rest included
        if not moves:
            dt = (hx * ds[2, k] + hy * ds[3, k]) / braking
            if held:
                tilt = ((cx - along * hx) * ds[2, k] + (cy - along * hy) * ds[3, k]) / speed  # of h c with the velocity
                tilt += (hx if k == 6 else 0.0) + (hy if k == 7 else 0.0)
                dt += (tilt - (slow if k == 10 else 0.0)) * speed / braking**2
            elif k == 10:
                dt -= stop
        turn = (hx * ds[3, k] - hy * ds[2, k]) / speed
        for i in range(2):
            v, a = slid[2 + i], c[i] - slow * h[i]
            da = slow * turn * (hy if i == 0 else -hx)
            if k == 10:
                da -= slow * h[i]
            elif k == 6 + i:
                da += 1.0
            d[i, k] = ds[i, k] + ds[2 + i, k] * t + (v + a * t) * dt + da * (t * t / 2)
            d[2 + i, k] = ds[2 + i, k] + da * t + a * dt if moves else 0.0
            d[4 + i, k] = ds[4 + i, k]


def polynomials(
    state: FloatArray, duration: float, friction: Friction
) -> list[tuple[str, float, float, FloatArray, FloatArray]]:
    """Pieces of one span (8,): phase, start, end (s after the start of the span), position (4, 2), slip (2, 2).

    Position and slip are coefficients of powers of the time since the piece began; pieces of no length are left out.
    """
    slide, stop = float(slide_time(state, friction)), float(rest_time(state, friction))
    x1, v1, a1 = _roll_start(state, friction)
    speed = float(np.hypot(*v1))
    roll = -friction.rolling * GRAVITY * v1 / max(speed, 1e-12) + state[6:8]
    zero = np.zeros(2)
    last = x1 + v1 * (stop - slide) + roll * (stop - slide) ** 2 / 2
    slip_rate = -state[4:6] / max(slide, 1e-12)
    pieces = [
        ("slide", 0.0, slide, np.array([state[0:2], state[2:4], a1 / 2, zero]), np.array([state[4:6], slip_rate])),
        ("roll", slide, stop, np.array([x1, v1, roll / 2, zero]), np.zeros((2, 2))),
        ("rest", stop, np.inf, np.array([last, zero, zero, zero]), np.zeros((2, 2))),
    ]
    cut = [(phase, t0, min(t1, duration), position, slip) for phase, t0, t1, position, slip in pieces]
    return [piece for piece in cut if piece[2] - piece[1] > 1e-9]


def _roll_start(state: FloatArray, friction: Friction) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position and velocity (..., 2) where rolling starts, and the acceleration (..., 2) before."""
    slip = state[..., 4:6]
    speed = np.hypot(slip[..., 0], slip[..., 1])[..., None]
    a = -friction.sliding * GRAVITY * slip / np.maximum(speed, 1e-12)
    t = 2 / 7 * speed / (friction.sliding * GRAVITY)
    return state[..., 0:2] + state[..., 2:4] * t + a * t**2 / 2, state[..., 2:4] + a * t, a


def _follow(state: NDArray, tau: NDArray, sliding: NDArray | float, rolling: NDArray | float) -> NDArray:  # type: ignore[type-arg]
    """Position, velocity, slip (..., 6) at tau (...) after the start of spans (..., 8); real or complex."""
    x, v, slip, extra = (state[..., k : k + 2] for k in (0, 2, 4, 6))
    slip_speed = np.sqrt(slip[..., 0] ** 2 + slip[..., 1] ** 2 + _TINY_SLIP)
    a = sliding * GRAVITY
    slide = 2 / 7 * slip_speed / a
    ts = np.where(np.real(tau) < np.real(slide), tau, slide)
    against = slip / slip_speed[..., None]
    push = (a * ts)[..., None] * against
    x = x + (v - push / 2) * ts[..., None]
    v = v - push
    slip = slip - 3.5 * push
    speed = np.sqrt(v[..., 0] ** 2 + v[..., 1] ** 2 + _TINY_SLIP)
    stop = speed / _deceleration(v, speed, extra, rolling * GRAVITY)
    tr = np.where(np.real(tau - ts) < np.real(stop), tau - ts, stop)[..., None]
    slow = extra - (rolling * GRAVITY / speed)[..., None] * v
    x = x + v * tr + slow * tr**2 / 2
    v = np.where(np.real(tau - ts - stop)[..., None] < 0, v + slow * tr, 0)
    return np.concatenate([x, v, slip], axis=-1)


def _deceleration(v: NDArray, speed: NDArray, extra: NDArray, rolling: NDArray | float) -> NDArray:  # type: ignore[type-arg]
    """Along the path, m/s^2 (...); never below a fifth of rolling resistance, so that every ball stops."""
    along = (v[..., 0] * extra[..., 0] + v[..., 1] * extra[..., 1]) / np.where(np.real(speed) > 1e-12, speed, 1.0)
    slow = rolling - along
    floor = 0.2 * rolling
    return np.where(np.real(slow) > np.real(floor), slow, floor)
