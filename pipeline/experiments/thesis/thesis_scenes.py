"""The simulated and recorded scenes of the thesis as series of coordinates with every other frame withheld.

Scene I is the double pendulum of Chen 2022, section 3.1.1, and a real one, recorded at 200 Hz; scene II a ball thrown
into fifty boxes, simulated by an independent engine in a separate process. Other simulations of the same kinds train
ConstraintNet.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.neural.common.method_interface import FittedMotion
from models.physics.springs.spring_system import (
    SpringSystem,
    build_springs,
    count_steps,
    evaluate_spring_rate,
    integrate_springs,
)
from pipeline.io.run_folder import read_csv_columns

# Frame rate (Hz) and noise (px) of the thesis.
BASE_SETTING = (30.0, 0.0)
# The variant of the thesis, or the first.
FIRST_VARIANT = {"double-pendulum": "stiff", "boxes": "800", "real": "0 s"}


@dataclass(frozen=True, slots=True)
class ExperimentCase:
    """One experiment."""

    scene: str
    """double-pendulum, real, boxes, pool."""
    variant: str
    """soft, medium, stiff; the speed of the ball; the start of a recording; a shot."""
    fps: float
    """Frame rate including withheld frames, Hz."""
    noise: float
    """px: standard deviation of the noise that is added to every visible coordinate."""
    seed: int
    """Seed of the noise, of the networks, and of the throw into the boxes."""

    @property
    def setting(self) -> tuple[str, str, float, float]:
        """Scene, variant, frame rate and noise."""
        return self.scene, self.variant, self.fps, self.noise

    @property
    def is_own(self) -> bool:
        """Whether this is the setting of the thesis."""
        return FIRST_VARIANT.get(self.scene) == self.variant and (self.fps, self.noise) == BASE_SETTING

    def __str__(self) -> str:
        return f"{self.variant}, {self.fps:.3g} Hz, noise {self.noise:g} px"


@dataclass(frozen=True, slots=True)
class WithheldSeries:
    """N points at T frames, px."""

    case: ExperimentCase
    t: FloatArray
    """(T,) s"""
    truth: FloatArray
    """(T, N, 2)"""
    observed: FloatArray
    """(T, N, 2) with noise; methods get every other row."""

    def __post_init__(self) -> None:
        if self.truth.shape != self.observed.shape or len(self.t) != len(self.truth) or len(self.t) % 2 == 0:
            raise ValueError(f"a series has an odd number of frames; got {self.truth.shape} at {self.t.shape}")

    @property
    def visible_samples(self) -> tuple[FloatArray, FloatArray]:
        """Times and coordinates that a method may use."""
        return self.t[::2], self.observed[::2]

    @property
    def withheld_samples(self) -> tuple[FloatArray, FloatArray]:
        """Times and true coordinates of the withheld midpoints."""
        return self.t[1::2], self.truth[1::2]


def build_series(case: ExperimentCase, t: FloatArray, truth: FloatArray) -> WithheldSeries:
    """Build the series of a case with its noise; of an even number of frames, the last is dropped."""
    count = len(t) - 1 + len(t) % 2
    noise = np.random.default_rng([case.seed, 1]).standard_normal(truth.shape)
    return WithheldSeries(case, t[:count], truth[:count], (truth + case.noise * noise)[:count])


def mean_squared_error(guess: FloatArray, truth: FloatArray) -> float:
    """Return the mean squared error.

    Args:
        guess: (H, N, 2) px.
        truth: (H, N, 2) px.

    Returns:
        px^2, mean over frames, points and coordinates.
    """
    return float(np.mean((guess - truth) ** 2))


@dataclass(frozen=True, slots=True)
class AssessedMotion(FittedMotion):
    """A fitted motion with warnings."""

    warnings: tuple[str, ...]
    """Reasons not to trust it; empty where there are none."""


# Duration of a simulated series, s.
SECONDS = 2.5
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


def _join_balls(kind: str) -> SpringSystem:
    """Join three balls, the first of which is fixed, by two springs."""
    stiffness, damping = SPRING_KINDS[kind]
    gravity = np.array([0.0, GRAVITY])
    return build_springs(np.ones(3), [(0, 1), (1, 2)], stiffness, damping, LENGTH, gravity, fixed=(0,))


@lru_cache(maxsize=16)
def simulate_double_pendulum(kind: str, t: tuple[float, ...]) -> FloatArray:
    """Simulate positions (T, 3, 2) px of the balls at times t s, from rest in a horizontal row."""
    graph = _join_balls(kind)
    start = np.zeros((2, 3, 2))
    start[0] = [[PIVOT[0] + LENGTH * ball, PIVOT[1]] for ball in range(3)]
    path = solve_ivp(
        lambda _, y: evaluate_spring_rate(graph, y.reshape(2, 3, 2)).ravel(), (t[0], t[-1]), start.ravel(),
        method="DOP853", rtol=ACCURACY, atol=ACCURACY, t_eval=t,
    )  # fmt: skip
    return np.asarray(path.y.T.reshape(len(t), 2, 3, 2)[:, 0], np.float64)


def build_pendulum_series(case: ExperimentCase, seconds: float = SECONDS) -> WithheldSeries:
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


WORLD = Path(__file__).resolve().parents[3] / "worlds" / "boxes.py"
# Speeds of the ball, px/s: the variants.
SPEEDS = ("400", "800", "1600")
# Simulated frame rate; lower rates use every second or fourth frame.
FRAME_RATE_HZ = 60
BOXES = 50


def build_boxes_series(case: ExperimentCase, seconds: float = SECONDS) -> WithheldSeries:
    """Build a series of the ball's centre and the corners of the boxes.

    Args:
        case: The experiment.
        seconds: Duration, s.

    Returns:
        Series of 201 points.

    Raises:
        OptionError: The simulation cannot run.
    """
    t, places = simulate_throw(case.variant, case.seed, seconds)
    step = round(FRAME_RATE_HZ / case.fps)
    return build_series(case, t[::step], places[::step])


@lru_cache(maxsize=4)
def simulate_throw(speed: str, seed: int, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Simulate a throw: times (T,) s and positions (T, 201, 2) px."""
    if not WORLD.is_file():
        raise OptionError(f"The boxes are moved by worlds/boxes.py of the repository; there is no {WORLD}")
    with TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, str(WORLD), folder, "--speed", speed, "--seed", str(seed), "--seconds", str(seconds),
             "--hz", str(FRAME_RATE_HZ)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise OptionError(f"The boxes need pymunk (the extra `check`): {done.stderr.strip().splitlines()[-1]}")
        columns = read_csv_columns(Path(folder) / "tracks.csv", ("t", "id", "x", "y"))
    points = 1 + 4 * BOXES
    places = np.stack([columns["x"], columns["y"]], axis=1).reshape(-1, points, 2)
    return np.asarray(columns["t"][::points], np.float64), np.asarray(places, np.float64)


def body_indices() -> NDArray[np.int64]:
    """Return the index of the body of each point; the ball is body 0.

    Returns:
        (201,) indices.
    """
    return np.concatenate([[0], 1 + np.repeat(np.arange(BOXES), 4)])


# Numbers of swings and throws.
SWING_COUNT, THROW_COUNT = 64, 6
# Largest initial angle from hanging, rad; that of the scene itself is pi/2.
MAX_ANGLE = 0.6 * np.pi
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
    graph = _join_balls(kind)
    spans, none = np.full(SWING_COUNT, span), np.empty(0, np.int64)
    steps, frames = count_steps(graph, spans, MAX_SPEED), [states[:, 0]]
    for _ in range(round(SECONDS / span)):
        states = integrate_springs(graph, states, spans, none, steps).ends
        frames.append(states[:, 0])
    return np.array(frames)
