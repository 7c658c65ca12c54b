"""The law of flight of `models.core.court.FlyingObject`, and its derivatives by all parameters of a flight.

The acceleration of a ball is -g z - k |v| v + |v| l x v with drag k, at a speed of 10 m/s, and lift l; at other speeds
the drag is k (|v| / 10 m/s)^n. A shuttle turns over after a hit, over a length of path and not a time, since the air
turns it (Cohen et al. 2015, doi:10.1088/1367-2630/17/6/063001). Its nose first points back, as slender as ahead; then
it lies across the path: at a length s of path its drag is larger by the factor 1 + c u^2 exp(-u) / 2 with u = 4 s / L.
It is lifted by exp(-s / L) l. Its nose lags behind its bending path by an angle that the air keeps in balance; the side
force of that angle carries a share `lag_lift` of the part of gravity that bends the path.
That share counts from the hit on, though the balance is reached only as the turn-over fades. The derivatives obey the
variational equations (Hairer, Norsett, Wanner 1993, section I.14), integrated together with the state.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from models.core.constants import GRAVITY
from models.core.court import FlyingObject
from models.core.rally import FLIGHT_PARAMETERS, Flight
from models.core.typing import FloatArray
from models.numerics.integrators import build_step_loop
from models.numerics.jit import compile_kernel

PARAMETER_COUNT = len(FLIGHT_PARAMETERS)
# Longest step, s, and largest relative loss of speed in a step: method of order 8, error below 1e-9 of the path.
_LONGEST_STEP, _LARGEST_LOSS = 0.04, 0.12
# Longest step as a share of the length of the turn-over; the factor by which the additional drag of the turn-over fades
# faster along the path than its lift; and the largest value of u^2 exp(-u) / 2, the course of that drag.
_TURN_SHARE, _TURN_RATE, _TURN_PEAK = 0.11, 4.0, 0.271
# (m/s)^2 that keep |v| differentiable at rest.
_MIN_SQUARE = 1e-8
# Integrated columns of derivatives: by velocity (3), drag, lift (3), turn-over, exponent of the drag and lift by lag;
# those by place are constant.
_COLUMNS = 10
# m/s at which the drag is stated.
_DRAG_SPEED = 10.0
# m/s above which a flight is impossible: no search may make the integration endless.
_LARGEST_SPEED = 400.0


@dataclass(frozen=True, slots=True)
class FlightPath:
    """States of a flight at K times."""

    states: FloatArray
    """(K, 6) place, m, and velocity, m/s."""
    accelerations: FloatArray
    """(K, 3) m/s^2."""
    derivatives: FloatArray
    """(K, 6, P) of the states by the parameters of the flight."""


@cache
def _build_flight() -> Any:
    """Build the compiled function that fills states (K, 6), accelerations (K, 3) and derivatives (K, 6, P)."""

    @compile_kernel
    def fill_rate(state, arguments, rate):  # type: ignore[no-untyped-def]
        # state: length of path, place (3), velocity (3), then the derivatives of these seven of every column
        k, l_x, l_y, l_z, turn, exponent, lag_lift, turn_length = arguments
        turns = turn_length > 0
        fading = np.exp(-state[0] / turn_length) if turns else 0.0
        lifting = fading if turns else 1.0
        u = max(_TURN_RATE * state[0] / turn_length, 0.0) if turns else 0.0
        bump = 0.5 * u * u * np.exp(-u)
        bump_slope = (u - 0.5 * u * u) * np.exp(-u) * _TURN_RATE / turn_length if turns else 0.0
        v_x, v_y, v_z = state[4], state[5], state[6]
        speed = np.sqrt(v_x * v_x + v_y * v_y + v_z * v_z + _MIN_SQUARE)
        logarithm = np.log(speed / _DRAG_SPEED)
        share = np.exp(exponent * logarithm)
        drag = k * (1 + turn * bump) * share
        carried, climb = lag_lift * GRAVITY, v_z / (speed * speed)
        side_x, side_y, side_z = l_y * v_z - l_z * v_y, l_z * v_x - l_x * v_z, l_x * v_y - l_y * v_x
        rate[0] = speed
        rate[1], rate[2], rate[3] = v_x, v_y, v_z
        rate[4] = speed * (lifting * side_x - drag * v_x) - carried * climb * v_x
        rate[5] = speed * (lifting * side_y - drag * v_y) - carried * climb * v_y
        rate[6] = speed * (lifting * side_z - drag * v_z) + carried * (1 - climb * v_z) - GRAVITY
        for column in range(_COLUMNS):
            at = 7 + 7 * column
            d_x, d_y, d_z = state[at + 4], state[at + 5], state[at + 6]
            along = (v_x * d_x + v_y * d_y + v_z * d_z) / speed
            fades = -fading / turn_length * state[at] if turns else 0.0
            d_drag = k * turn * bump_slope * state[at] * share + drag * exponent * along / speed
            d_climb = d_z / (speed * speed) - 2 * climb * along / speed
            rate[at] = along
            rate[at + 1], rate[at + 2], rate[at + 3] = d_x, d_y, d_z
            rate[at + 4] = along * (lifting * side_x - drag * v_x) + speed * (
                lifting * (l_y * d_z - l_z * d_y) - drag * d_x + fades * side_x - d_drag * v_x
            )
            rate[at + 4] -= carried * (d_climb * v_x + climb * d_x)
            rate[at + 5] = along * (lifting * side_y - drag * v_y) + speed * (
                lifting * (l_z * d_x - l_x * d_z) - drag * d_y + fades * side_y - d_drag * v_y
            )
            rate[at + 5] -= carried * (d_climb * v_y + climb * d_y)
            rate[at + 6] = along * (lifting * side_z - drag * v_z) + speed * (
                lifting * (l_x * d_y - l_y * d_x) - drag * d_z + fades * side_z - d_drag * v_z
            )
            rate[at + 6] -= carried * (d_climb * v_z + climb * d_z)
        by_exponent = -drag * logarithm * speed
        for column, by in (
            (3, -(1 + turn * bump) * share * speed),
            (7, -k * bump * share * speed),
            (8, by_exponent),
            (9, -GRAVITY * climb),
        ):
            at = 11 + 7 * column
            rate[at] += by * v_x
            rate[at + 1] += by * v_y
            rate[at + 2] += by * v_z
        rate[11 + 7 * 9 + 2] += GRAVITY
        push = speed * lifting
        rate[11 + 28 + 1] -= push * v_z  # by l_x: x x v = (0, -v_z, v_y)
        rate[11 + 28 + 2] += push * v_y
        rate[11 + 35] += push * v_z  # by l_y: y x v = (v_z, 0, -v_x)
        rate[11 + 35 + 2] -= push * v_x
        rate[11 + 42] -= push * v_y  # by l_z: z x v = (-v_y, v_x, 0)
        rate[11 + 42 + 1] += push * v_x

    take_steps = build_step_loop(fill_rate)

    @compile_kernel
    def fly(parameters, turn_length, times, states, accelerations, derivatives):  # type: ignore[no-untyped-def]
        state, rate, now = np.zeros(7 + 7 * _COLUMNS), np.zeros(7 + 7 * _COLUMNS), 0.0
        state[1:7] = parameters[:6]
        for column in range(3):
            state[7 + 7 * column + 4 + column] = 1.0
        arguments = (
            parameters[6], parameters[7], parameters[8], parameters[9], parameters[10], parameters[11],
            parameters[12], turn_length,
        )  # fmt: skip
        for k in range(len(times)):
            while now != times[k]:
                speed = np.sqrt(state[4] ** 2 + state[5] ** 2 + state[6] ** 2)
                if not speed < _LARGEST_SPEED:
                    states[k:] = np.nan
                    accelerations[k:] = np.nan
                    return
                turn = parameters[10] * _TURN_PEAK if turn_length > 0 and state[0] < 3 * turn_length else 0.0
                loss = speed * abs(parameters[6]) * (1 + abs(turn))
                longest = min(_LONGEST_STEP, _LARGEST_LOSS / loss) if loss > 0 else _LONGEST_STEP
                if turn_length > 0 and state[0] < 3 * turn_length:
                    longest = min(longest, _TURN_SHARE * turn_length / max(speed, 1.0))
                left = times[k] - now
                step = left if abs(left) <= longest else np.sign(left) * longest
                take_steps(state, arguments, step, 1)
                now = times[k] if abs(left) <= longest else now + step
            states[k] = state[1:7]
            fill_rate(state, arguments, rate)
            accelerations[k] = rate[4:7]
            derivatives[k] = 0.0
            for axis in range(3):
                derivatives[k, axis, axis] = 1.0
            for column in range(_COLUMNS):
                for row in range(6):
                    derivatives[k, row, 3 + column] = state[8 + 7 * column + row]

    return fly


def fly(parameters: FloatArray, times: FloatArray, turn_length: float) -> FlightPath:
    """Integrate a flight.

    Args:
        parameters: (P,) as `FLIGHT_PARAMETERS`, SI units; the last ones may be left out, and are 0.
        times: (K,) s after the start; negative ones go backwards.
        turn_length: m of path over which a shuttle turns over; 0 for a ball, and without a hit at the start.

    Returns:
        The states; NaN where the velocity leaves all bounds.
    """
    times = np.ascontiguousarray(times, np.float64)
    count = len(times)
    path = FlightPath(np.empty((count, 6)), np.empty((count, 3)), np.zeros((count, 6, PARAMETER_COUNT)))
    whole = np.zeros(PARAMETER_COUNT)
    whole[: len(parameters)] = parameters
    arguments = whole, float(turn_length), times
    _build_flight()(*arguments, path.states, path.accelerations, path.derivatives)
    return path


def fly_flight(flight: Flight, t: FloatArray, item: FlyingObject) -> FlightPath:
    """Integrate a fitted flight to times (K,), s of the clip; before its start and behind its end as well."""
    return fly(flight.parameters, np.asarray(t) - flight.start, item.turn_length if flight.begins_with_hit else 0.0)


def find_descent(
    parameters: FloatArray, turn_length: float, height: float, after: float, until: float, step: float = 0.01
) -> float:
    """Find when a flight first falls through a height.

    Args:
        parameters: (P,) of the flight.
        turn_length: m, as in `fly`.
        height: m.
        after: s after the start, from which to look.
        until: s after the start, up to which to look.
        step: s between looks.

    Returns:
        s after the start; NaN where it does not happen.
    """
    times = np.asarray(after + step * np.arange(max(int(np.ceil((until - after) / step)), 1) + 1), np.float64)
    above = fly(parameters, times, turn_length).states[:, 2] - height
    falls = np.flatnonzero((above[:-1] >= 0) & (above[1:] < 0))
    if not len(falls):
        return float("nan")
    low = times[falls[0]]
    t = low + step * above[falls[0]] / (above[falls[0]] - above[falls[0] + 1])
    for _ in range(3):  # Newton: the path is nearly straight over a step
        state = fly(parameters, np.array([t]), turn_length).states[0]
        t = t - (state[2] - height) / state[5] if state[5] < 0 else t
    return float(t)
