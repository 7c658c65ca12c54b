"""Scene II: a ball thrown into fifty boxes, simulated by an independent engine in a separate process."""

from __future__ import annotations

import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from models.core.errors import OptionError
from models.core.typing import FloatArray
from pipeline.experiments.thesis.scenes.withheld_series import ExperimentCase, WithheldSeries, build_series
from pipeline.io.run_folder import read_csv_columns

WORLD = Path(__file__).resolve().parents[4] / "worlds" / "boxes.py"
# Speeds of the ball, px/s: the variants.
SPEEDS = ("400", "800", "1600")
# Simulated frame rate; lower rates use every second or fourth frame.
FRAME_RATE_HZ = 60
BOXES = 50


def build_boxes_series(case: ExperimentCase, seconds: float) -> WithheldSeries:
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
