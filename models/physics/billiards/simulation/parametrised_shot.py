"""A shot played from the numbers of a fit: what they say of balls, table and physics, and derivatives by them.

A ball that moves at the beginning has seven numbers, x, y, vx, vy, the slip ux, uy of the point that touches the
cloth, and the surface speed R wz of its side spin (m, m/s); one that lies has its place. So all speeds have one size,
and a rolling ball has slip 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from models.core.scene import CUSHIONS, Table
from models.core.typing import BoolArray, FloatArray, IntArray
from models.numerics.jit import compiled
from models.physics.billiards.calibration_errors import FAITHFUL, ON_PICTURE
from models.physics.billiards.parameters import NAMES, Physics, neutral
from models.physics.billiards.simulation.shot_derivatives import PER_BALL
from models.physics.billiards.simulation.simulate_shot import simulate
from models.physics.billiards.simulation.simulated_shot import Balls, Run

MASS, RADIUS, FACTOR = (len(NAMES) + k for k in range(3))
NOSE, PICTURE = len(NAMES) + 3, len(NAMES) + 7
READOUT, FRAMES = PICTURE + len(ON_PICTURE), PICTURE + len(ON_PICTURE) + 1
NUMBERS: tuple[str, ...] = (
    *NAMES, "unequal_mass.ratio", "unequal_radius.ratio", "collision_radius.factor",
    *(f"nose.{side}" for side in CUSHIONS), *ON_PICTURE, "rolling_shutter.readout", "dropped_frames.frames",
)  # fmt: skip
"""All Q numbers that shots may share: of the physics, the balls, the table, and of what is seen of them."""
ABSENT = np.concatenate([neutral(), np.ones(3), np.zeros(4), FAITHFUL, np.zeros(2)])
"""(Q,) without any effect."""
MOVING, LYING, LINEAR = 7, 2, 4
"""Numbers of a ball that moves and of one that lies; those of its centre."""
SIDE_SPIN = 6
"""Which of them is the surface speed of side spin."""


@dataclass(frozen=True, slots=True)
class Laws:
    """By which balls and cushions touch; names of `models.physics.billiards.parameters`."""

    cushion: str = "mirror"
    ball: str = "inelastic"


def sizes(moving: BoolArray) -> NDArray[np.int64]:
    """(N + 1,) where the numbers of each ball begin, and their count."""
    return np.concatenate([[0], np.cumsum(np.where(moving, MOVING, LYING))]).astype(np.int64)


def unpacked(start: FloatArray, moving: BoolArray) -> FloatArray:
    """(N, 7) from the numbers of a start (S,); zeros for what a ball that lies has not."""
    whole, at = np.zeros((len(moving), MOVING)), sizes(moving)
    for k, moves in enumerate(moving):
        whole[k, : MOVING if moves else LYING] = start[at[k] : at[k + 1]]
    return whole


def packed(whole: FloatArray, moving: BoolArray) -> FloatArray:
    """(S,) from (N, 7)."""
    return np.concatenate([row[: MOVING if moves else LYING] for row, moves in zip(whole, moving, strict=True)])


def balls_of(start: FloatArray, moving: BoolArray, table: Table, values: FloatArray) -> Balls:
    """The balls that a start (S,) and all numbers (Q,) stand for."""
    count = len(moving)
    state, radius, mass = np.zeros((count, MOVING)), np.empty(count), np.empty(count)
    _fill_balls(start, moving, table.ball_radius, table.ball_mass, values, state, radius, mass)
    return Balls(_names(count), state, radius, mass)


@compiled
def _fill_balls(start, moving, usual_radius, usual_mass, values, state, radius, mass):  # type: ignore[no-untyped-def]
    """Fill state (N, 7), radius and mass (N,) of the engine; only the first ball is surely a usual one."""
    at = 0
    for k in range(len(moving)):
        radius[k] = usual_radius * values[FACTOR] * (values[RADIUS] if k > 0 else 1.0)
        mass[k] = usual_mass * (values[MASS] if k > 0 else 1.0)
        own = start[at : at + MOVING]
        if not moving[k]:
            state[k, :LYING] = own[:LYING]
            at += LYING
            continue
        state[k, :LINEAR] = own[:LINEAR]
        state[k, 4], state[k, 5] = (own[5] - own[3]) / radius[k], (own[2] - own[4]) / radius[k]
        state[k, 6] = own[SIDE_SPIN] / radius[k]
        at += MOVING


@cache
def _names(count: int) -> tuple[str, ...]:
    """Of balls that a fit knows by their numbers."""
    return tuple(str(k) for k in range(count))


def played(start: FloatArray, moving: BoolArray, table: Table, values: FloatArray, laws: Laws, seconds: float) -> Run:
    """The shot; ArithmeticError where balls meet without end."""
    physics = Physics(values[: len(NAMES)].copy(), (), laws.cushion, laws.ball)
    offsets = values[NOSE : NOSE + 4]
    return simulate(balls_of(start, moving, table, values), table, physics, max(seconds, 1e-6), offsets)


def directions_of(balls: Balls, moving: BoolArray, table: Table, values: FloatArray, numbers: IntArray) -> FloatArray:
    """What the engine's numbers (9 N + P + 4,) change by when a start (S,) or one of `numbers`, indices (M,) in
    `NUMBERS`, changes: (9 N + P + 4, S + M)."""
    begins = int(moving.sum()) * (MOVING - LYING) + len(moving) * LYING
    found = np.zeros((PER_BALL * len(moving) + len(NAMES) + len(CUSHIONS), begins + len(numbers)))
    _fill_directions(balls.state, balls.radius, moving, table.ball_mass, values, numbers, begins, found)
    return found


@compiled
def _fill_directions(state, radius, moving, usual_mass, values, numbers, begins, found):  # type: ignore[no-untyped-def]
    """Fill found (9 N + P + 4, `begins` + M) as `directions_of` says; `begins` is where the starts of balls end."""
    at, physics = 0, PER_BALL * len(moving)
    for k in range(len(moving)):
        ball, own = found[PER_BALL * k : PER_BALL * (k + 1)], MOVING if moving[k] else LYING
        for i in range(MOVING):
            for j in range(own):
                ball[i, at + j] = _UNITS[j, i] if i < LINEAR else _UNITS[j, i] / radius[k]
        at += own
        for column in range(len(numbers)):
            number, place = numbers[column], begins + column
            if number == FACTOR or (number == RADIUS and k > 0):
                for i in range(LINEAR, MOVING):
                    ball[i, place] = -state[k, i] / radius[k] * radius[k] / values[number]
                ball[MOVING, place] = radius[k] / values[number]
            elif number == MASS and k > 0:
                ball[PER_BALL - 1, place] = usual_mass
    for column in range(len(numbers)):
        number = numbers[column]
        if number < MASS:
            found[physics + number, begins + column] = 1.0
        elif NOSE <= number < PICTURE:
            found[physics + MASS + number - NOSE, begins + column] = 1.0


_UNITS = np.eye(MOVING)
"""Row j: x, y, vx, vy and R wx, R wy, R wz by number j of a ball: R wx = uy - vy, R wy = vx - ux."""
_UNITS[2:6, 4:6] = [[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]]


def spins(numbers: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Numbers (N, 7) of a fit as states of the engine, and the matrix (7, 7) that turns one into the other."""
    turn = _UNITS.T / np.where(np.arange(MOVING) < LINEAR, 1.0, radius)[:, None]
    return numbers @ turn.T, turn


def slips(states: FloatArray, radius: FloatArray) -> FloatArray:
    """States (..., N, 7) of the engine as numbers of a fit, for radii (N,)."""
    found = states.copy()
    found[..., 4] = states[..., 2] - radius * states[..., 5]
    found[..., 5] = states[..., 3] + radius * states[..., 4]
    found[..., 6] = states[..., 6] * radius
    return found
