"""Cases of rendered rallies: each a clip with its truth in a folder of its own, made once."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.core.court_camera import CourtCamera, CourtScene
from models.core.typing import FloatArray
from models.sports.sport_catalogue import find_sports
from video.rendering.court_scene import View, read_rally
from video.rendering.rally_clips import simulate_rallies, write_rally_clip

# Turns of views and rates over the rallies of a sport; their numbers share no divisor.
VIEWS: tuple[View, ...] = ("broadcast", "broadcast", "phone")
RATES = (25, 30, 50, 60)
HIGH_SHARE = 5
"""Every so many rallies, one is filmed at 1080p."""


@dataclass(frozen=True)
class CourtCase:
    """A rally of a sport by its number, as it is filmed."""

    sport: str
    number: int
    seed: int
    strokes: tuple[int, int]

    @property
    def view(self) -> View:
        return VIEWS[self.number % len(VIEWS)]

    @property
    def fps(self) -> int:
        return RATES[self.number % len(RATES)]

    @property
    def size(self) -> tuple[int, int]:
        return (1920, 1080) if self.number % HIGH_SHARE == HIGH_SHARE - 1 else (1280, 720)

    @property
    def name(self) -> str:
        return f"{self.sport}_{self.seed}_{self.number:03d}"


@dataclass(frozen=True)
class CourtTruth:
    """Truth of a clip of T frames, as `video.rendering.rally_clips` writes it."""

    folder: Path
    stated: dict[str, Any]
    columns: dict[str, FloatArray]
    scene: CourtScene

    @property
    def fps(self) -> float:
        return float(self.stated["fps"])


def render_case(case: CourtCase, folder: Path) -> Path:
    """Render a case below a folder, unless it is there; returns its folder."""
    target = folder / case.name
    if not (target / "truth.json").exists():
        seed = int(np.random.SeedSequence([case.seed, case.number, len(case.sport)]).generate_state(1)[0])
        (path,) = simulate_rallies(case.sport, seed, 1, target / "rally", strokes=case.strokes)
        write_rally_clip(target, read_rally(path), case.view, case.fps, seed, case.size)
    return target


def read_truth(folder: Path) -> CourtTruth:
    """Read the truth of a clip."""
    stated = json.loads((folder / "truth.json").read_text())
    with np.load(folder / "truth.npz") as arrays:
        columns = dict(arrays)
    motion = columns["motion"] if len(columns["motion"]) else None
    size = (stated["width"], stated["height"])
    # a calibrated camera that is practically exact
    camera = CourtCamera(columns["camera"], 1e-12 * np.eye(8), *size, stated["is_left_handed"], motion)
    return CourtTruth(folder, stated, columns, CourtScene(find_sports()[stated["sport"]], camera, 0.0))
