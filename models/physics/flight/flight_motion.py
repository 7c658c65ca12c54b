"""The law of flight of `models.core.court.FlyingObject`, and its derivatives by all parameters of a flight.

The acceleration is -g z - k (1 + c exp(-t / tau)) |v| v + |v| l x v with drag k, turn-over drag c, its time tau and
lift l; for the drag of a turning shuttle see Cohen et al. 2015, doi:10.1088/1367-2630/17/6/063001. The derivatives
obey the variational equations (Hairer, Norsett, Wanner 1993, section I.14), integrated together with the state.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from models.core.court import FlyingObject
from models.core.rally import FLIGHT_PARAMETERS, Flight
from models.core.typing import FloatArray
from models.numerics.integrators import build_step_loop
from models.numerics.jit import compile_kernel

GRAVITY = 9.81
PARAMETER_COUNT = len(FLIGHT_PARAMETERS)
# Longest step, s, and largest relative loss of speed in a step: method of order 8, error below 1e-9 of the path.
_LONGEST_STEP, _LARGEST_LOSS = 0.04, 0.12
# (m/s)^2 that keep |v| differentiable at rest.
_MIN_SQUARE = 1e-8
# Integrated columns of derivatives: by velocity (3), drag, lift (3) and turn-over; those by place are constant.
_COLUMNS = 8
# m/s above which a flight is impossible: no search may make the integration endless.
_LARGEST_SPEED = 400.0


@dataclass(frozen=True, slots=True)
class FlightPath:
    """States of a flight at K times."""

    states: FloatArray
    """(K, 6) place, m, and velocity, m/s."""
    derivatives: FloatArray
    """(K, 6, 11) of the states by the parameters of the flight."""


@cache
def _build_flight() -> Any:
    """Build the compiled function that fills states (K, 6) and their derivatives (K, 6, 11)."""

    @compile_kernel
    def fill_rate(state, arguments, rate):  # type: ignore[no-untyped-def]
        # state: time, place (3), velocity (3), then of every column the derivatives of place (3) and velocity (3)
        k, l_x, l_y, l_z, turn, turn_time = arguments
        fading = np.exp(-state[0] / turn_time) if turn_time > 0 else 0.0
        drag = k * (1 + turn * fading)
        v_x, v_y, v_z = state[4], state[5], state[6]
        speed = np.sqrt(v_x * v_x + v_y * v_y + v_z * v_z + _MIN_SQUARE)
        side_x, side_y, side_z = l_y * v_z - l_z * v_y, l_z * v_x - l_x * v_z, l_x * v_y - l_y * v_x
        rate[0] = 1.0
        rate[1], rate[2], rate[3] = v_x, v_y, v_z
        rate[4] = speed * (side_x - drag * v_x)
        rate[5] = speed * (side_y - drag * v_y)
        rate[6] = speed * (side_z - drag * v_z) - GRAVITY
        for column in range(_COLUMNS):
            at = 7 + 6 * column
            d_x, d_y, d_z = state[at + 3], state[at + 4], state[at + 5]
            along = (v_x * d_x + v_y * d_y + v_z * d_z) / speed
            rate[at], rate[at + 1], rate[at + 2] = d_x, d_y, d_z
            rate[at + 3] = along * (side_x - drag * v_x) + speed * (l_y * d_z - l_z * d_y - drag * d_x)
            rate[at + 4] = along * (side_y - drag * v_y) + speed * (l_z * d_x - l_x * d_z - drag * d_y)
            rate[at + 5] = along * (side_z - drag * v_z) + speed * (l_x * d_y - l_y * d_x - drag * d_z)
        for column, by in ((3, -(1 + turn * fading) * speed), (7, -k * fading * speed)):
            at = 10 + 6 * column
            rate[at] += by * v_x
            rate[at + 1] += by * v_y
            rate[at + 2] += by * v_z
        rate[35] -= speed * v_z  # by l_x: x x v = (0, -v_z, v_y)
        rate[36] += speed * v_y
        rate[40] += speed * v_z  # by l_y: y x v = (v_z, 0, -v_x)
        rate[42] -= speed * v_x
        rate[46] -= speed * v_y  # by l_z: z x v = (-v_y, v_x, 0)
        rate[47] += speed * v_x

    take_steps = build_step_loop(fill_rate)

    @compile_kernel
    def fly(parameters, turn_time, times, states, derivatives):  # type: ignore[no-untyped-def]
        state = np.zeros(7 + 6 * _COLUMNS)
        state[1:7] = parameters[:6]
        for column in range(3):
            state[7 + 6 * column + 3 + column] = 1.0
        arguments = (parameters[6], parameters[7], parameters[8], parameters[9], parameters[10], turn_time)
        for k in range(len(times)):
            left = times[k] - state[0]
            while left != 0.0:
                speed = np.sqrt(state[4] ** 2 + state[5] ** 2 + state[6] ** 2)
                if not speed < _LARGEST_SPEED:
                    states[k:] = np.nan
                    return
                turn = parameters[10] * np.exp(-state[0] / turn_time) if turn_time > 0 else 0.0
                loss = speed * abs(parameters[6]) * (1 + abs(turn))
                longest = min(_LONGEST_STEP, _LARGEST_LOSS / loss) if loss > 0 else _LONGEST_STEP
                if turn_time > 0 and abs(turn) > 1e-4:
                    longest = min(longest, turn_time / 3)
                step = left if abs(left) <= longest else np.sign(left) * longest
                take_steps(state, arguments, step, 1)
                left = times[k] - state[0] if abs(left) > longest else 0.0
            states[k] = state[1:7]
            derivatives[k] = 0.0
            for axis in range(3):
                derivatives[k, axis, axis] = 1.0
            for column in range(_COLUMNS):
                for row in range(6):
                    derivatives[k, row, 3 + column] = state[7 + 6 * column + row]

    return fly


def fly(parameters: FloatArray, times: FloatArray, turn_time: float) -> FlightPath:
    """Integrate a flight.

    Args:
        parameters: (11,) as `FLIGHT_PARAMETERS`, SI units.
        times: (K,) s after the start; negative ones go backwards.
        turn_time: Time constant of the turn-over drag, s; 0 where the flight does not begin with a hit.

    Returns:
        The states; NaN where the velocity leaves all bounds.
    """
    times = np.ascontiguousarray(times, np.float64)
    states, derivatives = np.empty((len(times), 6)), np.zeros((len(times), 6, PARAMETER_COUNT))
    _build_flight()(np.array(parameters, np.float64), float(turn_time), times, states, derivatives)
    return FlightPath(states, derivatives)


def fly_flight(flight: Flight, t: FloatArray, item: FlyingObject) -> FlightPath:
    """Integrate a fitted flight to times (K,), s of the clip; before its start and behind its end as well."""
    return fly(flight.parameters, np.asarray(t) - flight.start, item.turn_time if flight.begins_with_hit else 0.0)


def find_descent(
    parameters: FloatArray, turn_time: float, height: float, after: float, until: float, step: float = 0.01
) -> float:
    """Find when a flight first falls through a height.

    Args:
        parameters: (11,) of the flight.
        turn_time: s, as in `fly`.
        height: m.
        after: s after the start, from which to look.
        until: s after the start, up to which to look.
        step: s between looks.

    Returns:
        s after the start; NaN where it does not happen.
    """
    times = after + step * np.arange(max(int(np.ceil((until - after) / step)), 1) + 1)
    above = fly(parameters, times, turn_time).states[:, 2] - height
    falls = np.flatnonzero((above[:-1] >= 0) & (above[1:] < 0))
    if not len(falls):
        return float("nan")
    low = times[falls[0]]
    t = low + step * above[falls[0]] / (above[falls[0]] - above[falls[0] + 1])
    for _ in range(3):  # Newton: the path is nearly straight over a step
        state = fly(parameters, np.array([t]), turn_time).states[0]
        t = t - (state[2] - height) / state[5] if state[5] < 0 else t
    return float(t)
