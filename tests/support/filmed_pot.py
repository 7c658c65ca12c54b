"""A cut into the bottom right pocket, played by the engine and filmed with noise."""

from __future__ import annotations

from functools import cache

import numpy as np
from support.filmed_shots import PX_PER_M, RADIUS, scene

from models.core.tracks import Tracks
from models.physics.billiards.cushion_geometry import find_mouth_line
from models.physics.billiards.simulation.simulate_shot import BallSet, Physics, SimulatedShot, simulate

R, FPS, LEAD, NOISE = RADIUS, 60.0, 0.2, 3e-4
SCENE = scene(pockets=True)
TARGET = np.array([2.54, 1.27])
RED, CUE = np.array([2.0, 0.9]), np.array([1.2, 0.62])


@cache
def play_pot() -> SimulatedShot:
    """Play the shot: the red ball goes to the corner, cut to the right."""
    line = (TARGET - RED) / np.hypot(*(TARGET - RED))
    way = RED - 2 * R * line - CUE
    v = 1.8 * way / np.hypot(*way)
    state = np.zeros((2, 7))
    state[0] = [*CUE, *v, -0.5 * v[1] / R, 0.5 * v[0] / R, 0.0]
    state[1, :2] = RED
    physics = Physics.from_effects(
        {"sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.01}, "spin_decay": {"rate": 10.0},
         "cushion_restitution": {"e": 0.85}, "ball_restitution": {"e": 0.95}},
    )  # fmt: skip
    return simulate(BallSet(("cue", "red"), state, np.full(2, R), np.full(2, 0.17)), SCENE.table, physics, 3.0)


def film_pot(seed: int) -> Tracks:
    """Film it at 60 frames per second, with 0.3 mm of noise, from 0.2 s before the strike."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(2.6 * FPS)) / FPS
    xy = play_pot().states_at(np.clip(t - LEAD, 0.0, None))[..., :2]
    xy = xy + rng.normal(0, NOISE, xy.shape)
    shape = xy.shape[:2]
    sigma = np.full(shape, NOISE)
    return Tracks(
        np.arange(len(t)), t, ("cue", "red"), ("cue", "red"), xy, PX_PER_M * xy + 50, sigma, sigma, np.zeros_like(xy),
        np.full(shape, PX_PER_M * R), np.array([[90.0, 0.0, 5.0], [45.0, 60.0, 35.0]]),
    )  # fmt: skip


def true_numbers() -> dict[str, float]:
    """Return the numbers of the shot by their definitions, from states around the contact."""
    shot = play_pot()
    strike = shot.states_at(0.0)[0]
    t = float(shot.contacts[0, 1])
    before, after = shot.states_at(t - 1e-7), shot.states_at(t + 1e-7)
    line = before[1, :2] - before[0, :2]
    mouth = find_mouth_line(SCENE.table, "bottom-right")
    late = shot.states_at(np.linspace(t, float(shot.pocket_times[1]) - 1e-6, 20_001))[:, 1, :2]
    passage = late[int(np.argmax((late - mouth.middle) @ mouth.outward > 0))]
    fine = shot.states_at(np.linspace(0, 2.6 - LEAD, 20_001))[:, 0, :2]
    return {
        "cue_speed": float(np.hypot(*strike[2:4])),
        "direction": angle_of(np.array([1.0, 0.0]), strike[2:4]),
        "top_spin_share": 0.5,
        "contact_speed": float(np.hypot(*before[0, 2:4])),
        "cut_angle": angle_of(before[0, 2:4], line),
        "object_speed": float(np.hypot(*after[1, 2:4])),
        "length": float(np.linalg.norm(np.diff(fine, axis=0), axis=1).sum()),
        "pocket_offset": 1e3 * float((passage - TARGET) @ np.array([-1.0, 1.0]) / np.sqrt(2)),
    }


def angle_of(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle from a to b, degrees, x towards y."""
    return float(np.degrees(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))
