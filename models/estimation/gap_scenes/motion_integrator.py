"""Integration of a body under a given acceleration, with known inputs and with walls that reflect it.

Every body is integrated by Runge-Kutta steps from its own start. A step that ends behind a wall is cut at the wall,
where the velocity changes at once. All of it works with complex numbers, so that complex steps give the derivatives by
start and parameters (Squire, Trapp 1998, doi:10.1137/S003614459631241X), also across a reflection: the time of a
contact is a root of the simulated path, and Newton's method carries its derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.numerics.jit import compile_kernel

RealOrComplexArray = NDArray[np.float64] | NDArray[np.complex128]
# Fills the acceleration (D,) from position (D,), velocity (D,), parameters (P,) and inputs (I,); compiled, for real and
# complex.
AccelerationFunction = Callable[
    [RealOrComplexArray, RealOrComplexArray, RealOrComplexArray, RealOrComplexArray, RealOrComplexArray], None
]
Integrator = Callable[
    [RealOrComplexArray, RealOrComplexArray, FloatArray, float, FloatArray, FloatArray],
    tuple[RealOrComplexArray, FloatArray],
]

# s of one step: the fourth-order error of a pendulum of 1 Hz is then below 1e-8 in a second.
MAX_STEP = 1 / 200
# Steps between two rows, at most: rows that are further apart than 2 s resolve no motion, and the times of a recording
# in another unit must not make a simulation endless.
MAX_STEPS_PER_ROW = 400
# m/s or rad/s below which the probe vanishes.
_BRAKE_FADE_SPEED = 0.01
# m/s, normal speed below which a body stays at a wall: far below what a camera resolves.
_MIN_BOUNCE_SPEED = 1e-3
# Contacts in one step, at most: two in a corner, and a body that is pressed against a wall comes to rest there.
_MAX_CONTACTS_PER_STEP = 8
# Newton iterations for the time of a contact: a path is nearly straight over `MAX_STEP`.
_NEWTON_STEPS = 4


@compile_kernel
def fill_curves(first: FloatArray, last: FloatArray, length: float, curves: FloatArray) -> None:
    """Fill the coefficients (I, 4) of the cubics with values and rates (I, 2) at both ends of an interval (s)."""
    for k in range(len(first)):
        rise = (last[k, 0] - first[k, 0]) / length
        curves[k, 0], curves[k, 1] = first[k, 0], first[k, 1]
        curves[k, 2] = (3 * rise - 2 * first[k, 1] - last[k, 1]) / length
        curves[k, 3] = (first[k, 1] + last[k, 1] - 2 * rise) / length**2


@cache
def build_integrator(
    acceleration: AccelerationFunction, has_walls: bool = False, wall_parameters: tuple[int, int] | None = None
) -> Integrator:
    """Build a compiled integrator of an acceleration, and of a brake probe, which has the last four parameters.

    Args:
        acceleration: Acceleration of one body.
        has_walls: Whether walls reflect the bodies.
        wall_parameters: Indices of the restitution and the friction of walls; without them, walls are elastic and
            smooth.

    Returns:
        Function of n starts (2D, n), n sets of parameters (P, n), times (T,) s, a step limit (s), walls (D, 2) (lower
        and upper limit of each coordinate) and inputs (N, T, I, 2) (value and rate at every row, of N bodies that share
        the n starts evenly and in order; (N, 0, I, 2) where all are 0), to states (T, 2D, n) and times of the last wall
        contact before each row (T, n) s, NaN where there was none.
    """
    has_wall_parameters = wall_parameters is not None
    at_restitution, at_friction = wall_parameters or (0, 0)

    @compile_kernel
    def advance(now, h, p, curves, since, work, end):  # type: ignore[no-untyped-def]
        """Fill the state `end` (2D,) a step h after `now`, which is `since` after the row where `curves` begin."""
        at, rate, sum_of_rates, given = work
        size = len(now)
        half = size // 2
        probe = p[-4:]
        braked = (probe != 0).any()
        sum_of_rates[:] = 0.0
        for stage in range(4):
            part = 0.0 * h if stage == 0 else (h if stage == 3 else 0.5 * h)
            for d in range(size):
                at[d] = now[d] + part * rate[d] if stage else now[d]
            for d in range(half):
                rate[d] = at[half + d]
            s = since + part
            for k in range(len(curves)):
                given[k] = ((curves[k, 3] * s + curves[k, 2]) * s + curves[k, 1]) * s + curves[k, 0]
            acceleration(at[:half], at[half:], p, given, rate[half:])
            if braked:
                square = 0 * p[0] + _BRAKE_FADE_SPEED**2
                for d in range(half, size):
                    square += at[d] * at[d]
                speed = np.sqrt(square)
                brake = probe[0] / speed + probe[1] + probe[2] * speed + probe[3] * speed * speed
                for d in range(half, size):
                    rate[d] -= brake * at[d]
            weight = 2.0 if stage == 1 or stage == 2 else 1.0
            for d in range(size):
                sum_of_rates[d] += weight * rate[d]
        for d in range(size):
            end[d] = now[d] + h / 6 * sum_of_rates[d]

    @compile_kernel
    def find_wall(now, end, walls):  # type: ignore[no-untyped-def]
        """Return coordinate (-1: none), side (0 lower, 1 upper) and share of the step of the first contact."""
        half = len(now) // 2
        axis, upper, first = -1, 0, 2.0
        for d in range(half):
            for side in range(2):
                sign = 2.0 * side - 1.0
                depth = sign * (end[d].real - walls[d, side])
                if depth > 0 and sign * end[half + d].real > 0:
                    before = sign * (now[d].real - walls[d, side])
                    share = before / (before - depth) if before < 0 else 0.0
                    if share < first:
                        axis, upper, first = d, side, share
        return axis, upper, first

    @compile_kernel
    def reflect(state, axis, sign, p):  # type: ignore[no-untyped-def]
        """Change the velocity of a state (2D,) that meets a wall normal to a coordinate."""
        half = len(state) // 2
        approach = sign * state[half + axis]
        restitution, friction = 1.0 + 0 * p[0], 0 * p[0]
        if has_wall_parameters:
            restitution, friction = p[at_restitution], p[at_friction]
        if approach.real < _MIN_BOUNCE_SPEED:
            restitution = 0 * p[0]
        state[half + axis] = -sign * restitution * approach
        square = 0 * p[0]
        for d in range(half):
            if d != axis:
                square += state[half + d] * state[half + d]
        if square.real > 0:
            speed = np.sqrt(square)
            loss = friction * (1 + restitution) * approach
            left = 1 - loss / speed if loss.real < speed.real else 0 * p[0]
            for d in range(half):
                if d != axis:
                    state[half + d] *= left

    @compile_kernel
    def advance_between_walls(now, h, p, curves, since, work, end, walls):  # type: ignore[no-untyped-def]
        """Advance `now` (2D,) by a step h; return the time of the last contact, s after the row, or -1."""
        half = len(now) // 2
        left, passed, contact = h + 0 * p[0], since + 0 * p[0], -1.0
        for _ in range(_MAX_CONTACTS_PER_STEP):
            advance(now, left, p, curves, passed, work, end)
            axis, upper, share = find_wall(now, end, walls)
            if axis < 0:
                break
            sign, place = 2.0 * upper - 1.0, walls[axis, upper]
            tau = share * left
            if share > 0:
                for _ in range(_NEWTON_STEPS):
                    advance(now, tau, p, curves, passed, work, end)
                    if sign * end[half + axis].real < 1e-6:
                        break  # it hardly reaches the wall
                    tau = tau - (end[axis] - place) / end[half + axis]
                if not 0 <= tau.real <= left.real:
                    tau = share * left
                advance(now, tau, p, curves, passed, work, end)
                end[axis] = place
            else:  # it begins behind the wall, by an error of its start
                end[:] = now
            reflect(end, axis, sign, p)
            now[:] = end
            left, passed = left - tau, passed + tau
            contact = passed.real
        else:
            advance(now, left, p, curves, passed, work, end)
            for d in range(half):
                for side in range(2):
                    sign = 2.0 * side - 1.0
                    if sign * (end[d].real - walls[d, side]) > 0 and sign * end[half + d].real > 0:
                        end[d], end[half + d] = walls[d, side], 0.0
        now[:] = end
        return contact

    @compile_kernel
    def march(start, parameters, t, longest, walls, inputs):  # type: ignore[no-untyped-def]
        size, count = start.shape
        states = np.empty((len(t), size, count), start.dtype)
        contacts = np.full((len(t), count), np.nan)
        now, end, at, rate, sum_of_rates = np.empty((5, size), start.dtype)
        given = np.zeros(inputs.shape[2], start.dtype)
        work = at, rate, sum_of_rates, given
        driven, curves = inputs.shape[1] > 0, np.zeros((inputs.shape[2], 4))
        for i in range(count):
            p = parameters[:, i].copy()
            body = i * inputs.shape[0] // count
            now[:] = start[:, i]
            states[0, :, i] = now
            for k in range(1, len(t)):
                length = t[k] - t[k - 1]
                steps = int(min(np.ceil(length / longest - 1e-9), MAX_STEPS_PER_ROW))
                h = length / steps
                if driven:
                    fill_curves(inputs[body, k - 1], inputs[body, k], length, curves)
                contacts[k, i] = contacts[k - 1, i]
                for n in range(steps):
                    if has_walls:
                        contact = advance_between_walls(now, h, p, curves, n * h, work, end, walls)
                        if contact >= 0:
                            contacts[k, i] = t[k - 1] + contact
                    else:
                        advance(now, h, p, curves, n * h, work, end)
                        now[:] = end
                states[k, :, i] = now
        return states, contacts

    integrator: Integrator = march
    return integrator
