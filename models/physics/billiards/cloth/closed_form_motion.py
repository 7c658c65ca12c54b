"""Closed-form motion of a ball on the cloth between two contacts: it slides, rolls, rests.

A sliding ball feels constant friction against its slip (the velocity of the point that touches the cloth), whose
direction does not change while it slides; the path is a parabola (Marlow 1995, The Physics of Pocket Billiards). A
rolling ball decelerates at mu_r g along its path. Side spin does not act on the centre.

A segment begins in eight numbers: x, y (m), vx, vy (m/s), slip ux, uy of the contact point (m/s), and an extra
acceleration while rolling, cx, cy (m/s^2).
"""

from __future__ import annotations

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import SEGMENT_STATE_SIZE, ClothFriction
from models.core.typing import FloatArray
from models.numerics.jit import compile_kernel

# m^2/s^2 under the root of |u|: keeps the derivative finite where the ball rolls from the start.
_TINY_SLIP = 1e-12


def spin_from_slip(v: FloatArray, slip: FloatArray, radius: float) -> FloatArray:
    """Compute the spin of a ball from its velocity and slip.

    Args:
        v: (..., 2) velocity of the centre, m/s.
        slip: (..., 2) velocity of the contact point, m/s.
        radius: m.

    Returns:
        (..., 2) wx, wy in rad/s.
    """
    return np.stack([slip[..., 1] - v[..., 1], v[..., 0] - slip[..., 0]], axis=-1) / radius


def sliding_duration(state: FloatArray, friction: ClothFriction) -> FloatArray:
    """Compute how long balls slide.

    Args:
        state: (..., 8) initial states of segments.
        friction: Friction of the cloth.

    Returns:
        (...) s.
    """
    time: FloatArray = 2 / 7 * np.hypot(state[..., 4], state[..., 5]) / (friction.sliding * GRAVITY)
    return time


def duration_until_rest(state: FloatArray, friction: ClothFriction) -> FloatArray:
    """Compute how long balls move until they rest, if nothing touches them.

    Args:
        state: (..., 8) initial states of segments.
        friction: Friction of the cloth.

    Returns:
        (...) s.
    """
    _, v, _ = _find_rolling_start(state, friction)
    speed, rolling = np.hypot(v[..., 0], v[..., 1]), friction.rolling * GRAVITY
    along = (v * state[..., 6:8]).sum(axis=-1) / np.where(speed > 1e-12, speed, 1.0)
    # at least a fifth of rolling resistance, so that every ball stops
    time: FloatArray = sliding_duration(state, friction) + speed / np.maximum(rolling - along, 0.2 * rolling)
    return time


def evaluate_kinematics(state: FloatArray, tau: FloatArray, friction: ClothFriction) -> FloatArray:
    """Evaluate the motion of segments.

    Args:
        state: (M, 8) initial states of segments.
        tau: (M,) s since the start of each.
        friction: Friction of the cloth.

    Returns:
        (M, 6) position (m), velocity and slip (m/s).
    """
    return differentiate_kinematics(state, tau, friction)[0]


def differentiate_kinematics(
    state: FloatArray, tau: FloatArray, friction: ClothFriction
) -> tuple[FloatArray, FloatArray]:
    """Evaluate the motion of segments and its derivatives.

    Args:
        state: (M, 8) initial states of segments.
        tau: (M,) s since the start of each.
        friction: Friction of the cloth.

    Returns:
        The motion (M, 6) as `evaluate_kinematics`, and its derivatives (M, 6, 11) by the state, tau, ln mu_sliding and
        ln mu_rolling.
    """
    value, slope = np.empty((len(tau), 6)), np.empty((len(tau), 6, SEGMENT_STATE_SIZE + 3))
    _differentiate_segments(
        np.require(state, np.float64, ["C", "W"]), np.require(tau, np.float64, ["C", "W"]), friction.sliding,
        friction.rolling, value, slope,
    )  # fmt: skip
    return value, slope


@compile_kernel
def _differentiate_segments(state, tau, sliding, rolling, value, slope):  # type: ignore[no-untyped-def]
    """Write value (M, 6) and slope (M, 6, 11): the motion and its derivatives, written by hand.

    Fits spend most of their time here. The inputs are the state (8,), tau (s), ln mu_sliding, ln mu_rolling, in this
    order.
    """
    slid, ds = np.empty(7), np.empty((7, 11))  # x, v, slip where sliding ends, and the time left from there
    for row in range(len(tau)):
        differentiate_segment(state[row], tau[row], sliding, rolling, slid, ds, value[row], slope[row])


@compile_kernel
def differentiate_segment(state, tau, sliding, rolling, slid, ds, value, slope):  # type: ignore[no-untyped-def]
    """Evaluate the motion of one segment and its derivatives.

    Args:
        state: (8,) initial state of the segment.
        tau: s since the start.
        sliding: Coefficient of sliding friction.
        rolling: Coefficient of rolling resistance.
        slid: (7,) workspace.
        ds: (7, 11) workspace.
        value: (6,) receives position, velocity and slip.
        slope: (6, 11) receives their derivatives by the state, tau, ln mu_sliding and ln mu_rolling.
    """
    _differentiate_sliding(state, tau, sliding * GRAVITY, slid, ds)
    _differentiate_rolling(slid, ds, state[6], state[7], rolling * GRAVITY, value, slope)


@compile_kernel
def _differentiate_sliding(s, tau, a, out, d):  # type: ignore[no-untyped-def]
    """Write place, velocity, slip and the time left (7,) after sliding at `a` m/s^2 for at most tau s; d (7, 11)."""
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


@compile_kernel
def _differentiate_rolling(slid, ds, cx, cy, slow, out, d):  # type: ignore[no-untyped-def]
    """Write the state (6,) after rolling at `slow` m/s^2 for the time left or until rest.

    d (6, 11) receives its derivatives, through those before, ds (7, 11).
    """
    speed = np.sqrt(slid[2] * slid[2] + slid[3] * slid[3] + _TINY_SLIP)
    hx, hy = slid[2] / speed, slid[3] / speed
    along = hx * cx + hy * cy
    braking = max(slow - along, 0.2 * slow)
    stop = speed / braking
    moves = slid[6] < stop
    t = slid[6] if moves else stop
    h, c, slows_down = (hx, hy), (cx, cy), not moves and braking > 0.2 * slow
    out[4], out[5] = slid[4], slid[5]
    for i in range(2):
        v, a = slid[2 + i], c[i] - slow * h[i]
        out[i] = slid[i] + v * t + a * t * t / 2
        out[2 + i] = v + a * t if moves else 0.0
    for k in range(11):  # loops over numbers: whole rows would take several times as long to compile
        dt = ds[6, k]  # of t, that of rest included
        if not moves:
            dt = (hx * ds[2, k] + hy * ds[3, k]) / braking
            if slows_down:
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


def split_into_polynomials(
    state: FloatArray, duration: float, friction: ClothFriction
) -> list[tuple[str, float, float, FloatArray, FloatArray]]:
    """Split one segment into pieces that are polynomials in time.

    Args:
        state: (8,) initial state of the segment.
        duration: s.
        friction: Friction of the cloth.

    Returns:
        Per piece: phase (slide, roll or rest), start and end (s since the start of the segment), position (4, 2)
        and slip (2, 2) as coefficients of powers of the time since the piece began. Pieces without duration are left
        out.
    """
    slide, stop = float(sliding_duration(state, friction)), float(duration_until_rest(state, friction))
    x1, v1, a1 = _find_rolling_start(state, friction)
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


def _find_rolling_start(state: FloatArray, friction: ClothFriction) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position and velocity (..., 2) where rolling starts, and the acceleration (..., 2) before."""
    slip = state[..., 4:6]
    speed = np.hypot(slip[..., 0], slip[..., 1])[..., None]
    a = -friction.sliding * GRAVITY * slip / np.maximum(speed, 1e-12)
    t = 2 / 7 * speed / (friction.sliding * GRAVITY)
    return state[..., 0:2] + state[..., 2:4] * t + a * t**2 / 2, state[..., 2:4] + a * t, a
