"""The rendered sample clips with their exact truth, for tests that otherwise need footage outside the repository."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.tables import TABLE_PRESETS

SAMPLES = Path(__file__).resolve().parents[2] / "sample_videos"
NAMES = sorted(path.name.removesuffix(".truth.json") for path in SAMPLES.glob("*.truth.json"))


@dataclass(frozen=True, slots=True)
class SampleTruth:
    """Where the N balls of a sample clip are in its T frames."""

    path: Path
    scene: dict[str, Any]
    """The content of the truth file: table, camera, physics, events."""
    ids: tuple[str, ...]
    t: FloatArray
    """(T,) s."""
    xy: FloatArray
    """(T, N, 2) m on the table."""
    px: FloatArray
    """(T, N, 2) px; NaN where the ball is not visible."""
    radius_px: FloatArray
    """(T, N)."""

    @property
    def table(self) -> Table:
        """The table that the clip shows."""
        return TABLE_PRESETS[self.scene["table"]["name"]]

    @property
    def events(self) -> list[dict[str, Any]]:
        """True strikes, contacts, pockets and rests, in the order of time."""
        return list(self.scene["events"])


def read_sample_truth(name: str) -> SampleTruth:
    """Read the truth of one sample clip."""
    scene = json.loads((SAMPLES / f"{name}.truth.json").read_text())
    with (SAMPLES / f"{name}.truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    ids = tuple(ball["id"] for ball in scene["balls"])
    count = max(int(row["frame"]) for row in rows) + 1
    t, xy, px = np.full(count, np.nan), np.full((count, len(ids), 2), np.nan), np.full((count, len(ids), 2), np.nan)
    radius = np.full((count, len(ids)), np.nan)
    for row in rows:
        frame, ball = int(row["frame"]), ids.index(row["id"])
        t[frame] = float(row["t"])
        xy[frame, ball] = float(row["x"]), float(row["y"])
        if row["visible"] == "1":
            px[frame, ball] = float(row["x_px"]), float(row["y_px"])
            radius[frame, ball] = float(row["radius_px"])
    return SampleTruth(SAMPLES / f"{name}.mp4", scene, ids, t, xy, px, radius)
