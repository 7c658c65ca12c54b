"""Read the folder of a run from its csv and json files alone, as other programs do."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
FOOTAGE = ROOT.parent / "shared" / "data" / "billiards"


@dataclass(frozen=True)
class RunFolder:
    """Tracks, events and trajectory as columns, scene as parsed json."""

    path: Path
    tracks: dict[str, np.ndarray]
    events: dict[str, np.ndarray]
    trajectory: dict[str, np.ndarray]
    scene: dict[str, Any]

    def to_pixels(self, xy: np.ndarray) -> np.ndarray:
        """Project ball centres (..., 2) m to pixels of the reference frame."""
        matrix = np.array(self.scene["calibration"]["matrix"], dtype=float)
        height = np.full((*xy.shape[:-1], 1), self.scene["ball_radius"])
        u = np.concatenate([xy, height, np.ones_like(height)], axis=-1) @ matrix.T
        return u[..., :2] / u[..., 2:]

    def ids_of_kind(self, *kinds: str) -> list[str]:
        """Return the ids of the balls of these classes, those with most rows first."""
        ids = self.tracks["id"][np.isin(self.tracks["kind"], kinds)]
        names, counts = np.unique(ids, return_counts=True)
        return [str(n) for n in names[np.argsort(-counts, kind="stable")]]

    def path_of(self, ball: str) -> tuple[np.ndarray, np.ndarray]:
        """Return times (K,) s and pixels (K, 2) of the fitted motion of a ball."""
        rows = self.trajectory["id"] == ball
        t, x, y = (self.trajectory[c][rows].astype(float) for c in ("t", "x", "y"))
        return t, self.to_pixels(np.stack([x, y], axis=-1))


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Read a csv file as columns of numbers (empty cells NaN) or of strings."""
    with path.open(newline="", encoding="utf-8") as lines:
        reader = csv.reader(lines)
        names = next(reader)
        rows = list(reader)
    columns = {}
    for k, name in enumerate(names):
        cells = [row[k] for row in rows]
        try:
            columns[name] = np.array([float(c) if c else np.nan for c in cells])
        except ValueError:
            columns[name] = np.array(cells, dtype=str)
    for name in ("id", "kind", "a", "b"):
        if name in columns and columns[name].dtype.kind == "f":
            columns[name] = np.array([row[names.index(name)] for row in rows], dtype=str)
    return columns


def read_run(path: Path) -> RunFolder:
    return RunFolder(
        path,
        *(read_columns(path / f"{name}.csv") for name in ("tracks", "events", "trajectory")),
        json.loads((path / "scene.json").read_text()),
    )


@dataclass(frozen=True)
class Outcome:
    """Exit status, duration and last printed line of `trueroll run`."""

    status: int
    seconds: float
    sentence: str


def run_clip(clip: Path, out: Path, *options: str) -> Outcome:
    """Run `trueroll run CLIP -o OUT` as a separate process."""
    start = time.perf_counter()
    done = subprocess.run(
        [str(Path(sys.executable).with_name("trueroll")), "run", str(clip), "-o", str(out), *options],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = (done.stderr.strip() or done.stdout.strip()).splitlines()
    return Outcome(done.returncode, time.perf_counter() - start, lines[-1] if lines else "")
