"""Scene I: the double pendulum of Chen 2022, section 3.1.1, and a real one, recorded at 200 Hz."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.physics.springs.spring_system import build_springs, evaluate_spring_rate
from pipeline.experiments.thesis.scenes.withheld_series import ExperimentCase, WithheldSeries, build_series

# Stiffness (mass/s^2) and damping (mass/s) of springs, which the thesis does not state; masses are 1.
SPRING_KINDS = {"soft": (300.0, 0.1), "medium": (3e3, 1.0), "stiff": (1e5, 20.0)}
# px/s^2: 100 px are a metre.
GRAVITY = 981.0
# px: rest length and initial distance of the balls.
LENGTH = 80.0
# px: the fixed ball.
PIVOT = (200.0, 190.0)
# Relative and absolute tolerance of the integration.
ACCURACY = 1e-10
RECORDING = "double_freeswing_200Hz.npz"
RECORDED_HZ = 200.0
# First sample of each variant of the recording.
STARTS = {"0 s": 0, "15 s": 3000, "30 s": 6000}
# Duration of a recorded series, s.
RECORDED_SECONDS = 10.0


@lru_cache(maxsize=16)
def simulate_double_pendulum(kind: str, t: tuple[float, ...]) -> FloatArray:
    """Simulate positions (T, 3, 2) px of the balls at times t s, from rest in a horizontal row."""
    stiffness, damping = SPRING_KINDS[kind]
    graph = build_springs(
        np.ones(3), [(0, 1), (1, 2)], stiffness, damping, LENGTH, np.array([0.0, GRAVITY]), fixed=(0,)
    )
    start = np.zeros((2, 3, 2))
    start[0] = [[PIVOT[0] + LENGTH * ball, PIVOT[1]] for ball in range(3)]
    path = solve_ivp(
        lambda _, y: evaluate_spring_rate(graph, y.reshape(2, 3, 2)).ravel(), (t[0], t[-1]), start.ravel(),
        method="DOP853", rtol=ACCURACY, atol=ACCURACY, t_eval=t,
    )  # fmt: skip
    return np.asarray(path.y.T.reshape(len(t), 2, 3, 2)[:, 0], np.float64)


def build_pendulum_series(case: ExperimentCase, seconds: float) -> WithheldSeries:
    """Build the series of a simulated double pendulum.

    Args:
        case: The experiment.
        seconds: Duration, s.

    Returns:
        Series of three points.
    """
    t = np.arange(round(seconds * case.fps) + 1) / case.fps
    return build_series(case, t, simulate_double_pendulum(case.variant, tuple(t)))


def read_recorded_series(case: ExperimentCase, folder: Path, seconds: float = RECORDED_SECONDS) -> WithheldSeries:
    """Read a recorded double pendulum (dynamicslab/MultiArm-Pendulum) as three points with arms of 80 px.

    Args:
        case: The experiment; its frame rate selects every so many of the 200 samples per second.
        folder: Folder with the recording.
        seconds: Duration, s.

    Returns:
        Series of three points.

    Raises:
        OptionError: The recording is missing.
    """
    path = folder / RECORDING
    if not path.is_file():
        raise OptionError(f"The real pendulum needs {RECORDING}; there is none in {folder}")
    with np.load(path) as recorded:
        t, theta = recorded["t"], np.stack([recorded["theta1"], recorded["theta2"]], axis=1)
    start, step = STARTS[case.variant], round(RECORDED_HZ / case.fps)
    rows = slice(start, start + round(seconds * RECORDED_HZ) + 1, step)
    # the recording counts angles from the upright
    return build_series(case, t[rows] - t[start], convert_to_points(np.unwrap(theta, axis=0)[rows] - np.pi))


def find_recording(folder: Path | None) -> Path | None:
    """Find the folder that holds the recording.

    Args:
        folder: Folder to search, with its subfolders.

    Returns:
        The folder; None where there is none.
    """
    if folder is None or not folder.is_dir():
        return None
    return next((path.parent for path in sorted(folder.rglob(RECORDING))), None)


def convert_to_points(angles: FloatArray) -> FloatArray:
    """Convert angles of a double pendulum to points.

    Args:
        angles: (T, 2) absolute angles, rad, 0 hanging.

    Returns:
        (T, 3, 2) px of pivot, joint and end; y down.
    """
    arms = LENGTH * np.stack([np.sin(angles), np.cos(angles)], axis=2)
    steps = np.concatenate([np.broadcast_to(PIVOT, (len(angles), 1, 2)), arms], axis=1)
    return np.asarray(np.cumsum(steps, axis=1), np.float64)


def convert_to_angles(points: FloatArray) -> FloatArray:
    """Convert points of a double pendulum to angles.

    Args:
        points: (T, 3, 2) px of pivot, joint and end; y down.

    Returns:
        (T, 2) absolute angles, rad, 0 hanging, unwrapped.
    """
    arms = np.diff(points, axis=1)
    return np.asarray(np.unwrap(np.arctan2(arms[..., 0], arms[..., 1]), axis=0), np.float64)
