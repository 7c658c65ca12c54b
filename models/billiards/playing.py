"""A shot played from the numbers of a fit: what they say of balls, table and physics, and derivatives by them.

A ball that moves at the beginning has seven numbers, x, y, vx, vy, the slip ux, uy of the point that touches the
cloth, and the surface speed R wz of its side spin (m, m/s); one that lies has its place. So all speeds have one size,
and a rolling ball has slip 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.billiards.parameters import NAMES, Physics, neutral
from models.billiards.run import Balls, Run
from models.billiards.sensitivities import BALL_COLUMNS
from models.billiards.simulate import simulate
from models.billiards.view import FAITHFUL, ON_PICTURE
from models.scene import CUSHIONS, Table

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

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
    """By which balls and cushions touch; names of `models.billiards.parameters`."""

    cushion: str = "mirror"
    ball: str = "inelastic"


def sizes(moving: Mask) -> NDArray[np.int64]:
    """(N + 1,) where the numbers of each ball begin, and their count."""
    return np.concatenate([[0], np.cumsum(np.where(moving, MOVING, LYING))]).astype(np.int64)


def unpacked(start: Floats, moving: Mask) -> Floats:
    """(N, 7) from the numbers of a start (S,); zeros for what a ball that lies has not."""
    whole, at = np.zeros((len(moving), MOVING)), sizes(moving)
    for k, moves in enumerate(moving):
        whole[k, : MOVING if moves else LYING] = start[at[k] : at[k + 1]]
    return whole


def packed(whole: Floats, moving: Mask) -> Floats:
    """(S,) from (N, 7)."""
    return np.concatenate([row[: MOVING if moves else LYING] for row, moves in zip(whole, moving, strict=True)])


def radii(table: Table, values: Floats, count: int) -> Floats:
    """(N,) m, at which balls touch each other and the noses."""
    ratio = np.where(np.arange(count) > 0, values[RADIUS], 1.0)
    return np.asarray(table.ball_radius * values[FACTOR] * ratio)


def balls_of(start: Floats, moving: Mask, table: Table, values: Floats) -> Balls:
    """The balls that a start (S,) and all numbers (Q,) stand for."""
    whole, count = unpacked(start, moving), len(moving)
    radius = radii(table, values, count)
    spin = np.stack([whole[:, 5] - whole[:, 3], whole[:, 2] - whole[:, 4], whole[:, 6]], axis=1) / radius[:, None]
    mass = table.ball_mass * np.where(np.arange(count) > 0, values[MASS], 1.0)
    names = tuple(str(k) for k in range(count))
    return Balls(names, np.concatenate([whole[:, :4], spin], axis=1), radius, mass)


def played(start: Floats, moving: Mask, table: Table, values: Floats, laws: Laws, seconds: float) -> Run:
    """The shot; ArithmeticError where balls meet without end."""
    physics = Physics(values[: len(NAMES)].copy(), (), laws.cushion, laws.ball)
    offsets = values[NOSE : NOSE + 4]
    return simulate(balls_of(start, moving, table, values), table, physics, max(seconds, 1e-6), offsets)


def directions_of(balls: Balls, moving: Mask, table: Table, values: Floats, numbers: Ints) -> Floats:
    """What the engine's numbers (9 N + P + 4,) change by when a start (S,) or one of `numbers`, indices (M,) in
    `NUMBERS`, changes: (9 N + P + 4, S + M)."""
    own = len(BALL_COLUMNS) * len(moving)
    of_balls = _of_balls(balls, moving, table, values)
    begins = of_balls.shape[1] - len(NUMBERS)
    found = np.zeros((own + len(NAMES) + len(CUSHIONS), begins + len(numbers)))
    found[:own, :begins] = of_balls[:, :begins]
    for column, number in enumerate(numbers, begins):
        found[:own, column] = of_balls[:, begins + number]
        if number < len(NAMES):
            found[own + number, column] = 1.0
        elif NOSE <= number < PICTURE:
            found[own + len(NAMES) + number - NOSE, column] = 1.0
    return found


def _of_balls(balls: Balls, moving: Mask, table: Table, values: Floats) -> Floats:
    """(9 N, S + Q): the engine's numbers of all balls by those of the fit."""
    at, count = sizes(moving), len(moving)
    found = np.zeros((count, len(BALL_COLUMNS), at[-1] + len(NUMBERS)))
    for k, radius in enumerate(balls.radius):
        own = MOVING if moving[k] else LYING
        found[k, :LINEAR, at[k] : at[k] + own] = _UNITS[:own, :LINEAR].T
        found[k, LINEAR:MOVING, at[k] : at[k] + own] = _UNITS[:own, LINEAR:].T / radius
        by_radius = np.concatenate([np.zeros(4), -balls.state[k, 4:] / radius, [1.0, 0.0]])
        found[k, :, at[-1] + FACTOR] = by_radius * radius / values[FACTOR]
        if k > 0:
            found[k, :, at[-1] + RADIUS] = by_radius * radius / values[RADIUS]
            found[k, -1, at[-1] + MASS] = table.ball_mass
    return found.reshape(-1, found.shape[2])


_UNITS = np.eye(MOVING)
"""Row j: x, y, vx, vy and R wx, R wy, R wz by number j of a ball: R wx = uy - vy, R wy = vx - ux."""
_UNITS[2:6, 4:6] = [[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]]


def spins(numbers: Floats, radius: float) -> tuple[Floats, Floats]:
    """Numbers (N, 7) of a fit as states of the engine, and the matrix (7, 7) that turns one into the other."""
    turn = _UNITS.T / np.where(np.arange(MOVING) < LINEAR, 1.0, radius)[:, None]
    return numbers @ turn.T, turn


def slips(states: Floats, radius: Floats) -> Floats:
    """States (..., N, 7) of the engine as numbers of a fit, for radii (N,)."""
    found = states.copy()
    found[..., 4] = states[..., 2] - radius * states[..., 5]
    found[..., 5] = states[..., 3] + radius * states[..., 4]
    found[..., 6] = states[..., 6] * radius
    return found
