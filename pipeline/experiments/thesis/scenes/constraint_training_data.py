"""Training data of ConstraintNet: frames of other simulations of the same kind."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from models.core.typing import FloatArray
from models.physics.springs.spring_system import build_springs, count_steps, integrate_springs
from pipeline.experiments.thesis.scenes.boxes_scene import FRAME_RATE_HZ, simulate_throw
from pipeline.experiments.thesis.scenes.double_pendulum_scene import GRAVITY, LENGTH, PIVOT, SPRING_KINDS

# Numbers of swings and throws.
SWING_COUNT, THROW_COUNT = 64, 6
# Largest initial angle from hanging, rad; that of the scene itself is pi/2.
MAX_ANGLE = 0.6 * np.pi
# Duration of a swing or throw, s.
SECONDS = 2.5
# First seed of training data; seeds of scenes are smaller.
FIRST_TRAINING_SEED = 10_000
# Largest speed of a ball relative to another, px/s; it sets the integration steps.
MAX_SPEED = 2000.0


def simulate_training_swings(kind: str, seconds: float, seed: int) -> FloatArray:
    """Simulate double pendulums like that of the scene, released from rest at other angles.

    Args:
        kind: Kind of springs.
        seconds: Time between the first and the last of three frames, s.
        seed: Seed of the angles.

    Returns:
        (B, 3, 3, 2) px: triples of neighbouring frames of three balls.
    """
    path = _simulate_swings(kind, seconds / 2, seed)  # (T, SWINGS, 3, 2)
    return _stack_frame_triples(path)


def simulate_training_throws(speed: str, seconds: float, seed: int) -> FloatArray:
    """Simulate other throws of the same speed.

    Args:
        speed: Variant of the boxes scene, px/s.
        seconds: Time between the first and the last of three frames, s.
        seed: Seed of the throws.

    Returns:
        (B, 3, 201, 2) px: triples of neighbouring frames of all points.
    """
    step = max(round(seconds / 2 * FRAME_RATE_HZ), 1)
    first = FIRST_TRAINING_SEED + THROW_COUNT * seed
    paths = np.stack([simulate_throw(speed, first + k, SECONDS)[1][::step] for k in range(THROW_COUNT)], axis=1)
    return _stack_frame_triples(paths)


def _stack_frame_triples(path: FloatArray) -> FloatArray:
    """Stack triples (B, 3, N, 2) of neighbouring frames of paths (T, S, N, 2)."""
    frames = np.stack([path[:-2], path[1:-1], path[2:]], axis=2)
    return frames.reshape(-1, *frames.shape[2:])


@lru_cache(maxsize=8)
def _simulate_swings(kind: str, span: float, seed: int) -> FloatArray:
    """Simulate paths (T, SWING_COUNT, 3, 2) px with a frame every `span` s."""
    angles = np.random.default_rng(FIRST_TRAINING_SEED + seed).uniform(-MAX_ANGLE, MAX_ANGLE, (SWING_COUNT, 2, 1))
    arms = LENGTH * np.concatenate([np.sin(angles), np.cos(angles)], axis=2)
    states = np.zeros((SWING_COUNT, 2, 3, 2))
    states[:, 0] = np.array(PIVOT) + np.concatenate([np.zeros((SWING_COUNT, 1, 2)), np.cumsum(arms, axis=1)], axis=1)
    stiffness, damping = SPRING_KINDS[kind]
    graph = build_springs(
        np.ones(3), [(0, 1), (1, 2)], stiffness, damping, LENGTH, np.array([0.0, GRAVITY]), fixed=(0,)
    )
    spans, none = np.full(SWING_COUNT, span), np.empty(0, np.int64)
    steps, frames = count_steps(graph, spans, MAX_SPEED), [states[:, 0]]
    for _ in range(round(SECONDS / span)):
        states = integrate_springs(graph, states, spans, none, steps).ends
        frames.append(states[:, 0])
    return np.array(frames)
