"""A shot from the parameters of a fit: the balls, table and physics that they stand for, and derivatives by them.

The start of a ball that moves at the start has seven numbers: x, y (m), vx, vy, the slip ux, uy of the point that
touches the cloth, and the surface speed R wz of its side spin (m/s). That of a ball at rest is its place. So all speeds
have one scale, and a rolling ball has slip 0. The starts of all balls follow each other in one vector (S,).

With d the place relative to the image centre in half table lengths and e = d / (1 + p . d), a place is measured at
s (1 + k1 |e|^2 + k2 |e|^4) e. Effects on the times of frames (`rolling_shutter`, `dropped_frames`) are applied
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from models.core.scene import CUSHIONS, Table
from models.core.typing import BoolArray, FloatArray, IntArray
from models.numerics.jit import compile_kernel, copy_numbers
from models.physics.billiards.parameter_vector import PARAMETER_NAMES, neutral_parameters
from models.physics.billiards.simulation.shot_derivatives import BALL_INPUTS
from models.physics.billiards.simulation.simulate_shot import simulate
from models.physics.billiards.simulation.simulated_shot import BallSet, SimulatedShot
from models.physics.billiards.simulation.table_physics import Physics

# Parameters that move measured places.
IMAGE_PARAMETERS = ("lens_distortion.k1", "perspective.p_x", "perspective.p_y", "scale.seen", "lens_second_term.k2")
# (5,) values of a perfect calibration.
NEUTRAL_IMAGE_PARAMETERS = np.array([0.0, 0.0, 0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class ImagePlacement:
    """Position of the image on the table."""

    centre: FloatArray
    """(2,) m, image centre."""
    half_length: float
    """m, half the length of the table: the unit of the lens."""
    height: float = 1.0
    """m, of the image on the table."""

    def image_rows(self, xy: FloatArray) -> FloatArray:
        """Compute the image rows of places.

        Args:
            xy: (..., 2) places, m.

        Returns:
            (...) rows relative to the image centre, as a part of the image height.
        """
        rows: FloatArray = (xy[..., 1] - self.centre[1]) / self.height
        return rows


def distort_places(
    placement: ImagePlacement, xy: FloatArray, parameters: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute where places are measured, and the derivatives.

    Args:
        placement: Position of the image on the table.
        xy: (..., 2) places, m.
        parameters: (5,) values of `IMAGE_PARAMETERS`.

    Returns:
        Measured places (..., 2), m; their derivatives (..., 2, 2) by the place and (..., 2, 5) by the parameters.
    """
    k1, p, scale, k2 = parameters[0], parameters[1:3], parameters[3], parameters[4]
    place = (xy - placement.centre) / placement.half_length
    foreshortening = (1 / (1 + place @ p))[..., None]
    projected = place * foreshortening
    radius_squared = np.sum(projected * projected, axis=-1)[..., None]
    magnification = 1 + (k1 + k2 * radius_squared) * radius_squared
    distorted = magnification * projected
    lens_jacobian = magnification[..., None] * np.eye(2)
    lens_jacobian += (2 * k1 + 4 * k2 * radius_squared)[..., None] * projected[..., :, None] * projected[..., None, :]
    perspective_jacobian = (
        foreshortening[..., None] * np.eye(2) - (foreshortening**2)[..., None] * place[..., :, None] * p
    )
    by_place = scale * lens_jacobian @ perspective_jacobian
    by_p = -scale * lens_jacobian @ (foreshortening**2 * place)[..., :, None] * place[..., None, :]
    by_lens = scale * np.stack([radius_squared * projected, radius_squared**2 * projected], axis=-1)
    by_numbers = np.concatenate([by_lens[..., :1], by_p, distorted[..., None], by_lens[..., 1:]], axis=-1)
    return placement.centre + placement.half_length * scale * distorted, by_place, placement.half_length * by_numbers


# Indices in `SHOT_PARAMETERS`.
MASS_RATIO, RADIUS_RATIO, RADIUS_FACTOR = (len(PARAMETER_NAMES) + k for k in range(3))
# Indices in `SHOT_PARAMETERS` of the first nose offset and of the first parameter of the image.
NOSE_OFFSETS, IMAGE_START = len(PARAMETER_NAMES) + 3, len(PARAMETER_NAMES) + 7
# Indices in `SHOT_PARAMETERS`.
SHUTTER_READOUT, DROPPED_FRAMES = IMAGE_START + len(IMAGE_PARAMETERS), IMAGE_START + len(IMAGE_PARAMETERS) + 1
# All Q parameters that shots may share: of the physics, the balls, the table, and the measurement.
SHOT_PARAMETERS: tuple[str, ...] = (
    *PARAMETER_NAMES, "unequal_mass.ratio", "unequal_radius.ratio", "collision_radius.factor",
    *(f"nose.{side}" for side in CUSHIONS), *IMAGE_PARAMETERS, "rolling_shutter.readout", "dropped_frames.frames",
)  # fmt: skip
# (Q,) values without any effect.
NEUTRAL_SHOT_PARAMETERS = np.concatenate(
    [neutral_parameters(), np.ones(3), np.zeros(4), NEUTRAL_IMAGE_PARAMETERS, np.zeros(2)]
)
# Numbers of a ball that moves, of a ball at rest, and of the motion of its centre alone.
MOVING_BALL_SIZE, RESTING_BALL_SIZE, CENTRE_SIZE = 7, 2, 4
# Index of the surface speed of side spin among them.
SIDE_SPIN = 6


@dataclass(frozen=True, slots=True)
class ContactModels:
    """Names of the contact models of a shot, see `table_physics`."""

    cushion: str = "mirror"
    ball: str = "inelastic"


def start_offsets(moving: BoolArray) -> NDArray[np.int64]:
    """Find where the numbers of each ball begin in a start.

    Args:
        moving: (N,) whether a ball moves at the start.

    Returns:
        (N + 1,) offsets; the last one is the length S.
    """
    return np.concatenate([[0], np.cumsum(np.where(moving, MOVING_BALL_SIZE, RESTING_BALL_SIZE))]).astype(np.int64)


def unpack_start(start: FloatArray, moving: BoolArray) -> FloatArray:
    """Unpack the flat vector of initial states into one row per ball.

    Args:
        start: (S,) numbers of all balls.
        moving: (N,) whether a ball moves at the start.

    Returns:
        (N, 7) numbers; 0 for those that a ball at rest lacks.
    """
    padded, offsets = np.zeros((len(moving), MOVING_BALL_SIZE)), start_offsets(moving)
    for k, moves in enumerate(moving):
        padded[k, : MOVING_BALL_SIZE if moves else RESTING_BALL_SIZE] = start[offsets[k] : offsets[k + 1]]
    return padded


def pack_start(padded: FloatArray, moving: BoolArray) -> FloatArray:
    """Pack one row per ball into a start.

    Args:
        padded: (N, 7) numbers of each ball.
        moving: (N,) whether a ball moves at the start.

    Returns:
        (S,) the start.
    """
    return np.concatenate(
        [row[: MOVING_BALL_SIZE if moves else RESTING_BALL_SIZE] for row, moves in zip(padded, moving, strict=True)]
    )


def build_balls(start: FloatArray, moving: BoolArray, table: Table, values: FloatArray) -> BallSet:
    """Build the balls that a start and all parameters stand for.

    Args:
        start: (S,) numbers of all balls.
        moving: (N,) whether a ball moves at the start.
        table: Table with the usual radius and mass of a ball.
        values: (Q,) values of `SHOT_PARAMETERS`.

    Returns:
        The balls, whose ids are their numbers.
    """
    count = len(moving)
    state, radius, mass = np.zeros((count, MOVING_BALL_SIZE)), np.empty(count), np.empty(count)
    fill_balls(start, moving, table.ball_radius, table.ball_mass, values, state, radius, mass)
    return BallSet(_number_balls(count), state, radius, mass)


@compile_kernel
def fill_balls(start, moving, usual_radius, usual_mass, values, state, radius, mass):  # type: ignore[no-untyped-def]
    """Write state (N, 7), radius (m) and mass (kg) (N,) of the engine.

    usual_radius (m) and usual_mass (kg) are those of the table; only the first ball is certain to have them.
    """
    at = 0
    for k in range(len(moving)):
        radius[k] = usual_radius * values[RADIUS_FACTOR] * (values[RADIUS_RATIO] if k > 0 else 1.0)
        mass[k] = usual_mass * (values[MASS_RATIO] if k > 0 else 1.0)
        own = start[at : at + MOVING_BALL_SIZE]
        if not moving[k]:
            copy_numbers(own[:RESTING_BALL_SIZE], state[k])
            at += RESTING_BALL_SIZE
            continue
        copy_numbers(own[:CENTRE_SIZE], state[k])
        state[k, 4], state[k, 5] = (own[5] - own[3]) / radius[k], (own[2] - own[4]) / radius[k]
        state[k, 6] = own[SIDE_SPIN] / radius[k]
        at += MOVING_BALL_SIZE


@cache
def _number_balls(count: int) -> tuple[str, ...]:
    """Return the ids of balls that a fit identifies by their numbers."""
    return tuple(str(k) for k in range(count))


def simulate_start(
    start: FloatArray, moving: BoolArray, table: Table, values: FloatArray, laws: ContactModels, seconds: float
) -> SimulatedShot:
    """Simulate the shot of a start.

    Args:
        start: (S,) numbers of all balls.
        moving: (N,) whether a ball moves at the start.
        table: Table with the usual radius and mass of a ball.
        values: (Q,) values of `SHOT_PARAMETERS`.
        laws: Contact models.
        seconds: Duration, s.

    Returns:
        The shot.

    Raises:
        ArithmeticError: The balls meet without end.
    """
    physics = Physics(values[: len(PARAMETER_NAMES)].copy(), (), laws.cushion, laws.ball)
    offsets = values[NOSE_OFFSETS : NOSE_OFFSETS + 4]
    return simulate(build_balls(start, moving, table, values), table, physics, max(seconds, 1e-6), offsets)


def build_directions(
    state: FloatArray, radius: FloatArray, moving: BoolArray, table: Table, values: FloatArray, numbers: IntArray
) -> FloatArray:
    """Build the derivatives of the engine's inputs by the numbers of a fit.

    Args:
        state: (N, 7) state of the balls at the start.
        radius: (N,) m.
        moving: (N,) whether a ball moves at the start.
        table: Table with the usual mass of a ball.
        values: (Q,) values of `SHOT_PARAMETERS`.
        numbers: (M,) indices in `SHOT_PARAMETERS`.

    Returns:
        (9 N + P + 4, S + M) derivatives of the engine's inputs by the start (S,), then by the parameters of `numbers`.
    """
    start_size = int(moving.sum()) * (MOVING_BALL_SIZE - RESTING_BALL_SIZE) + len(moving) * RESTING_BALL_SIZE
    directions = np.zeros((BALL_INPUTS * len(moving) + len(PARAMETER_NAMES) + len(CUSHIONS), start_size + len(numbers)))
    _fill_directions(state, radius, moving, table.ball_mass, values, numbers, start_size, directions)
    return directions


@compile_kernel
def _fill_directions(state, radius, moving, usual_mass, values, numbers, start_size, directions):  # type: ignore[no-untyped-def]
    """Write directions (9 N + P + 4, start_size + M) as `build_directions` describes; usual_mass in kg."""
    at, physics = 0, BALL_INPUTS * len(moving)
    for k in range(len(moving)):
        ball, own = (
            directions[BALL_INPUTS * k : BALL_INPUTS * (k + 1)],
            MOVING_BALL_SIZE if moving[k] else RESTING_BALL_SIZE,
        )
        for i in range(MOVING_BALL_SIZE):
            for j in range(own):
                ball[i, at + j] = _UNITS[j, i] if i < CENTRE_SIZE else _UNITS[j, i] / radius[k]
        at += own
        for column in range(len(numbers)):
            number, place = numbers[column], start_size + column
            if number == RADIUS_FACTOR or (number == RADIUS_RATIO and k > 0):
                for i in range(CENTRE_SIZE, MOVING_BALL_SIZE):
                    ball[i, place] = -state[k, i] / radius[k] * radius[k] / values[number]
                ball[MOVING_BALL_SIZE, place] = radius[k] / values[number]
            elif number == MASS_RATIO and k > 0:
                ball[BALL_INPUTS - 1, place] = usual_mass
    for column in range(len(numbers)):
        number = numbers[column]
        if number < MASS_RATIO:
            directions[physics + number, start_size + column] = 1.0
        elif NOSE_OFFSETS <= number < IMAGE_START:
            directions[physics + MASS_RATIO + number - NOSE_OFFSETS, start_size + column] = 1.0


# Row j: x, y, vx, vy and R wx, R wy, R wz by number j of a ball: R wx = uy - vy, R wy = vx - ux.
_UNITS = np.eye(MOVING_BALL_SIZE)
_UNITS[2:6, 4:6] = [[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]]


def convert_to_states(numbers: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Convert numbers of a fit to states of the engine.

    Args:
        numbers: (N, 7) numbers of each ball.
        radius: m, of all balls.

    Returns:
        States (N, 7), and the matrix (7, 7) that maps the numbers of one ball to its state.
    """
    turn = _UNITS.T / np.where(np.arange(MOVING_BALL_SIZE) < CENTRE_SIZE, 1.0, radius)[:, None]
    return numbers @ turn.T, turn


def convert_to_starts(states: FloatArray, radius: FloatArray) -> FloatArray:
    """Convert states of the engine to numbers of a fit.

    Args:
        states: (..., N, 7) states.
        radius: (N,) m.

    Returns:
        (..., N, 7) numbers of each ball.
    """
    starts = states.copy()
    starts[..., 4] = states[..., 2] - radius * states[..., 5]
    starts[..., 5] = states[..., 3] + radius * states[..., 4]
    starts[..., 6] = states[..., 6] * radius
    return starts
