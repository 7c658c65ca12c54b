"""The inputs of a simulated shot by name, its derivatives by them, and the energy of its balls."""

from __future__ import annotations

import numpy as np

from models.core.scene import CUSHIONS
from models.core.typing import FloatArray
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.shot_derivatives import BALL_COLUMNS
from models.physics.billiards.simulation.simulated_shot import STATE_SIZE, SimulatedShot


def list_inputs(run: SimulatedShot) -> tuple[str, ...]:
    """All inputs (P,) of a shot, in the order that `directional_derivatives` takes."""
    of_balls = [f"{ball}.{name}" for ball in run.balls.ids for name in BALL_COLUMNS]
    return (*of_balls, *PARAMETER_NAMES, *(f"nose.{side}" for side in CUSHIONS))


def differentiate_states(run: SimulatedShot, t: float | FloatArray, wrt: tuple[str, ...] = ()) -> FloatArray:
    """Derivatives (..., N, 7, len(wrt)) at times t (...), s; by all balls and the parameters present for no names."""
    inputs = list_inputs(run)
    names = wrt or (*inputs[: len(run.balls.ids) * len(BALL_COLUMNS)], *run.physics.present)
    directions = np.zeros((len(inputs), len(names)))
    directions[[inputs.index(name) for name in names], np.arange(len(names))] = 1.0
    times = np.asarray(t, dtype=np.float64)
    place = np.arange(times.size * len(run.balls.ids)).reshape(times.size, -1)
    derivatives = run.directional_derivatives(times.reshape(-1), place, directions, STATE_SIZE)
    return derivatives.reshape(*times.shape, len(run.balls.ids), STATE_SIZE, len(names))


def kinetic_energy(state: FloatArray, radius: FloatArray, mass: FloatArray) -> FloatArray:
    """Energies (..., N), J, of solid spheres in states (..., N, 7)."""
    v, w = np.sum(state[..., 2:4] ** 2, axis=-1), np.sum(state[..., 4:7] ** 2, axis=-1)
    return np.asarray(0.5 * mass * (v + 0.4 * radius**2 * w))
