"""Scene I: the double pendulum of Chen 2022, section 3.1.1, and a real one that was filmed at 200 Hz."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.physics.springs.spring_system import rate, springs
from pipeline.experiments.thesis.scenes.withheld_series import Case, Series, filmed

KINDS = {"soft": (300.0, 0.1), "medium": (3e3, 1.0), "stiff": (1e5, 20.0)}
"""Stiffness (mass/s^2) and damping (mass/s) of springs, which the thesis does not give; masses are 1."""
GRAVITY = 981.0
"""px/s^2: so that 100 px are a metre."""
LENGTH = 80.0
"""px: rest length, and distance of the balls at the start."""
FIRST = (200.0, 190.0)
"""px: the ball that is held."""
ACCURACY = 1e-10
RECORDING = "double_freeswing_200Hz.npz"
RECORDED_HZ = 200.0
STARTS = {"0 s": 0, "15 s": 3000, "30 s": 6000}
"""First sample of each variant of the recording."""
RECORDED_SECONDS = 10.0


@lru_cache(maxsize=16)
def swung(kind: str, t: tuple[float, ...]) -> FloatArray:
    """True places (T, 3, 2) px at times t s of the balls, from rest in a row."""
    stiffness, damping = KINDS[kind]
    graph = springs(np.ones(3), [(0, 1), (1, 2)], stiffness, damping, LENGTH, np.array([0.0, GRAVITY]), held=(0,))
    start = np.zeros((2, 3, 2))
    start[0] = [[FIRST[0] + LENGTH * ball, FIRST[1]] for ball in range(3)]
    path = solve_ivp(
        lambda _, y: rate(graph, y.reshape(2, 3, 2)).ravel(), (t[0], t[-1]), start.ravel(), method="DOP853",
        rtol=ACCURACY, atol=ACCURACY, t_eval=t,
    )  # fmt: skip
    return np.asarray(path.y.T.reshape(len(t), 2, 3, 2)[:, 0], np.float64)


def double_pendulum(case: Case, seconds: float) -> Series:
    """The scene as simulated."""
    t = np.arange(round(seconds * case.fps) + 1) / case.fps
    return filmed(case, t, swung(case.variant, tuple(t)))


def real_pendulum(case: Case, folder: Path, seconds: float = RECORDED_SECONDS) -> Series:
    """A recorded double pendulum (dynamicslab/MultiArm-Pendulum) as three points with arms of 80 px.

    `fps` picks every so manieth of its 200 samples a second. OptionError where the recording is missing.
    """
    path = folder / RECORDING
    if not path.is_file():
        raise OptionError(f"The real pendulum needs {RECORDING}; there is none in {folder}")
    with np.load(path) as recorded:
        t, theta = recorded["t"], np.stack([recorded["theta1"], recorded["theta2"]], axis=1)
    start, step = STARTS[case.variant], round(RECORDED_HZ / case.fps)
    rows = slice(start, start + round(seconds * RECORDED_HZ) + 1, step)
    # the recording counts angles from the upright
    return filmed(case, t[rows] - t[start], as_points(np.unwrap(theta, axis=0)[rows] - np.pi))


def recording_in(folder: Path | None) -> Path | None:
    """The folder at or below `folder` that holds the recording, None where there is none."""
    if folder is None or not folder.is_dir():
        return None
    return next((path.parent for path in sorted(folder.rglob(RECORDING))), None)


def as_points(angles: FloatArray) -> FloatArray:
    """(T, 3, 2) px of pivot, joint and end, of absolute angles (T, 2), 0 hanging; y down."""
    arms = LENGTH * np.stack([np.sin(angles), np.cos(angles)], axis=2)
    steps = np.concatenate([np.broadcast_to(FIRST, (len(angles), 1, 2)), arms], axis=1)
    return np.asarray(np.cumsum(steps, axis=1), np.float64)


def as_angles(points: FloatArray) -> FloatArray:
    """(T, 2) absolute angles, not wrapped, of `as_points`."""
    arms = np.diff(points, axis=1)
    return np.asarray(np.unwrap(np.arctan2(arms[..., 0], arms[..., 1]), axis=0), np.float64)
