"""Scene II: a ball thrown into fifty boxes, moved by a foreign engine in a process of its own."""

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
from pipeline.experiments.thesis.scenes.withheld_series import Case, Series, filmed
from pipeline.io.run_folder import read_table

WORLD = Path(__file__).resolve().parents[4] / "worlds" / "boxes.py"
SPEEDS = ("400", "800", "1600")
"""px/s: the variants."""
FILMED_HZ = 60
"""Slower rates are every so manieth of these frames."""
BOXES = 50


def boxes(case: Case, seconds: float) -> Series:
    """The ball's centre and the corners of the boxes, (T, 201, 2) px. OptionError where the world cannot run."""
    t, places = thrown(case.variant, case.seed, seconds)
    step = round(FILMED_HZ / case.fps)
    return filmed(case, t[::step], places[::step])


@lru_cache(maxsize=4)
def thrown(speed: str, seed: int, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Times (T,) s and places (T, 201, 2) px of a throw."""
    if not WORLD.is_file():
        raise OptionError(f"The boxes are moved by worlds/boxes.py of the repository; there is no {WORLD}")
    with TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, str(WORLD), folder, "--speed", speed, "--seed", str(seed), "--seconds", str(seconds),
             "--hz", str(FILMED_HZ)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise OptionError(f"The boxes need pymunk (the extra `check`): {done.stderr.strip().splitlines()[-1]}")
        columns = read_table(Path(folder) / "tracks.csv", ("t", "id", "x", "y"))
    points = 1 + 4 * BOXES
    places = np.stack([columns["x"], columns["y"]], axis=1).reshape(-1, points, 2)
    return np.asarray(columns["t"][::points], np.float64), np.asarray(places, np.float64)


def bodies() -> NDArray[np.int64]:
    """(201,) number of the body of each point: the ball is one of its own."""
    return np.concatenate([[0], 1 + np.repeat(np.arange(BOXES), 4)])
