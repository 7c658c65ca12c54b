"""Poses of other scenes of the same kind, from which ConstraintNet is taught."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from models.core.typing import FloatArray
from models.physics.springs.spring_system import flow, springs, steps_for
from pipeline.experiments.thesis.scenes.boxes_scene import FILMED_HZ, thrown
from pipeline.experiments.thesis.scenes.double_pendulum_scene import FIRST, GRAVITY, KINDS, LENGTH

SWINGS, THROWS = 64, 6
WIDEST = 0.6 * np.pi
"""rad from hanging: how far out an arm may be let go; the scene's own are at half a turn."""
SECONDS = 2.5
OTHER = 10_000
"""Seeds from here on are those of lessons, never of a scene."""
FASTEST = 2000.0
"""px/s of a ball against another."""


def swings(kind: str, seconds: float, seed: int) -> FloatArray:
    """(B, 3, 3, 2) px: stretches of double pendulums like that of the scene, let go from rest at other angles."""
    path = _swung(kind, seconds / 2, seed)  # (T, SWINGS, 3, 2)
    return _stretches(path)


def throws(speed: str, seconds: float, seed: int) -> FloatArray:
    """(B, 3, 201, 2) px: stretches of other throws of the same speed."""
    step = max(round(seconds / 2 * FILMED_HZ), 1)
    first = OTHER + THROWS * seed
    paths = np.stack([thrown(speed, first + k, SECONDS)[1][::step] for k in range(THROWS)], axis=1)
    return _stretches(paths)


def _stretches(path: FloatArray) -> FloatArray:
    """(B, 3, N, 2) of neighbouring frames of paths (T, S, N, 2)."""
    frames = np.stack([path[:-2], path[1:-1], path[2:]], axis=2)
    return frames.reshape(-1, *frames.shape[2:])


@lru_cache(maxsize=8)
def _swung(kind: str, span: float, seed: int) -> FloatArray:
    """(T, SWINGS, 3, 2) px, a frame every `span` s."""
    angles = np.random.default_rng(OTHER + seed).uniform(-WIDEST, WIDEST, (SWINGS, 2, 1))
    arms = LENGTH * np.concatenate([np.sin(angles), np.cos(angles)], axis=2)
    states = np.zeros((SWINGS, 2, 3, 2))
    states[:, 0] = np.array(FIRST) + np.concatenate([np.zeros((SWINGS, 1, 2)), np.cumsum(arms, axis=1)], axis=1)
    stiffness, damping = KINDS[kind]
    graph = springs(np.ones(3), [(0, 1), (1, 2)], stiffness, damping, LENGTH, np.array([0.0, GRAVITY]), held=(0,))
    spans, none = np.full(SWINGS, span), np.empty(0, np.int64)
    steps, found = steps_for(graph, spans, FASTEST), [states[:, 0]]
    for _ in range(round(SECONDS / span)):
        states = flow(graph, states, spans, none, steps).ends
        found.append(states[:, 0])
    return np.array(found)
