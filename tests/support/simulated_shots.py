"""Shots that the engine plays and a camera sees, as stretches of a fit."""

from __future__ import annotations

import numpy as np

from models.core.scene import Table
from models.estimation.whole_shot.shot_segments import ShotSegment
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.physics.billiards.simulation.parametrised_shot import (
    NEUTRAL_SHOT_PARAMETERS,
    SHOT_PARAMETERS,
    ContactModels,
    ImagePlacement,
    simulate_start,
)
from models.physics.effect import Prior

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.17, False)
VIEW = ImagePlacement(np.array([1.27, 0.635]), 1.27)
USUAL = {
    "sliding_friction.mu": 0.2, "rolling_resistance.mu": 0.01, "spin_decay.rate": 10.0, "cushion_restitution.e": 0.85,
    "cushion_friction.mu": 0.17, "ball_restitution.e": 0.95, "ball_friction.mu": 0.05,
}  # fmt: skip
LAWS = ContactModels()
SIGMA = 0.001
"""m"""


def numbers(**changed: float) -> np.ndarray:
    """All numbers (Q,): the usual physics, and what differs; dots of names are double underscores."""
    found = NEUTRAL_SHOT_PARAMETERS.copy()
    for name, value in {**USUAL, **{key.replace("__", "."): value for key, value in changed.items()}}.items():
        found[SHOT_PARAMETERS.index(name)] = value
    return found


def unknown(name: str, value: float, sigma: float) -> Prior:
    """A prior that leaves a number open."""
    return Prior(name, "1", value, sigma, False, (-np.inf, np.inf))


def opening(rng: np.random.Generator, balls: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (N, 7) of a cue ball that is played at another one, and which of them move."""
    start = np.zeros((balls, 7))
    while (np.linalg.norm(start[:, None, :2] - start[:, :2], axis=2) + np.eye(balls)).min() < 0.25:
        start[:, :2] = rng.uniform([0.15, 0.15], [2.39, 1.12], (balls, 2))
    aim = start[1, :2] - start[0, :2]
    angle = np.arctan2(aim[1], aim[0]) + rng.uniform(-0.8, 0.8) * 0.057 / np.hypot(*aim)
    speed = rng.uniform(1.2, 3.0)
    start[0, 2:4] = speed * np.array([np.cos(angle), np.sin(angle)])
    start[0, 4:6] = rng.uniform(0.1, 0.9) * start[0, 2:4] + rng.normal(size=2) * 0.1
    start[0, 6] = rng.uniform(-0.6, 0.6) * speed
    return start, np.arange(balls) == 0


def filmed(
    rng: np.random.Generator, values: np.ndarray, shot: int = 0, seconds: float = 1.5, laws: ContactModels = LAWS
) -> ShotSegment:  # fmt: skip
    """A stretch of the engine's own motion at 60 pictures a second, with noise."""
    start, moving = opening(rng)
    t = np.arange(round(60 * seconds)) / 60
    flat = np.concatenate([row[: 7 if moves else 2] for row, moves in zip(start, moving, strict=True)])
    xy = simulate_start(flat, moving, TABLE, values, laws, seconds).states_at(t)[..., :2]
    xy += SIGMA * rng.normal(size=xy.shape)
    whiten = np.broadcast_to(np.eye(2) / SIGMA, (*xy.shape[:2], 2, 2))
    row = (xy[..., 1] - 0.635) / 1.27
    late = np.where(t > seconds / 2, 1 / 60, 0.0)
    return ShotSegment(shot, 0.0, t, xy, whiten, start, moving, False, row, late)


def shots(
    stretches: tuple[ShotSegment, ...], unknowns: tuple[Prior, ...], values: np.ndarray, **options: object
) -> ShotWindows:
    """The model of a fit."""
    return ShotWindows(stretches, TABLE, unknowns, LAWS, values, VIEW, **options)  # type: ignore[arg-type]
