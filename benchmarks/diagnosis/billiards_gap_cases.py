"""The cases of `billiards_gap.py`: the kinds of the blind check, and harder variants, as recordings.

`pipeline/experiments/gapcheck/billiards_cases.py` defines the withheld effects and their strengths,
`worlds/billiards_table.py` plays and films the tables: `trueroll gapcheck --fps 62.5` uses the same shots of the same
kind and seed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from pipeline.experiments.gapcheck.billiards_cases import (
    BILLIARDS_KINDS,
    SINGLE_EFFECTS,
    BilliardsKind,
    Effects,
)
from pipeline.experiments.gapcheck.blind_case import simulate_experiment
from pipeline.io.track_folder import read_track_folders

# Frame rate; a frame is 16 samples of the simulator.
FPS = 62.5
# Effects that a table or a camera may lack entirely.
OPTIONAL_EFFECTS = SINGLE_EFFECTS[:13]
# Standard deviations of a strength just above the noise.
NEAR = (4.0, 6.0)


@dataclass(frozen=True, slots=True)
class BilliardsGapCase:
    """A kind, and the way in which it is harder than usual."""

    kind: BilliardsKind
    shots: int = 12
    fps: float = FPS
    noise: float = 1.0
    """Factor on the usual noise."""
    harder: Literal["", "weak", "slow", "few", "noisy"] = ""
    """`weak`: NEAR standard deviations, all else adjusted (billiards_gap.py)."""

    @property
    def name(self) -> str:
        return self.kind.case


def _harder_cases() -> Iterator[BilliardsGapCase]:
    """Generate harder variants of the kinds with a single missing effect."""
    kinds = {kind.case: kind for kind in BILLIARDS_KINDS}

    def called(name: str, words: str) -> BilliardsKind:
        return replace(kinds[name], case=f"{name}, {words}")

    yield from (BilliardsGapCase(called(name, "weak"), harder="weak") for name in OPTIONAL_EFFECTS)
    slow = f"{FPS / 2:g} fps"
    yield from (BilliardsGapCase(called(name, slow), fps=FPS / 2, harder="slow") for name in SINGLE_EFFECTS)
    yield from (BilliardsGapCase(called(name, "5 shots"), shots=5, harder="few") for name in SINGLE_EFFECTS)
    yield from (BilliardsGapCase(called(name, "1 px"), noise=1.0 / 0.3, harder="noisy") for name in SINGLE_EFFECTS)


CASES = {case.name: case for case in (*map(BilliardsGapCase, BILLIARDS_KINDS), *_harder_cases())}


def film_case(case: BilliardsGapCase, seed: int, strength: float = 1.0) -> tuple[tuple[Recording, ...], Effects]:
    """Film all shots of one table; returns them and the acting effects, with the missing ones times `strength`."""
    drawn = case.kind.draw_experiment(seed, case.shots, case.fps)
    drawn["noise"] *= case.noise
    effects: Effects = drawn["effects"]
    for name in case.kind.missing if strength != 1.0 else ():
        effects[name] = {parameter: strength * value for parameter, value in effects[name].items()}
    return _play_case(case.kind, drawn), effects


def _play_case(kind: BilliardsKind, drawn: dict[str, Any]) -> tuple[Recording, ...]:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "case"
        simulate_experiment(kind, drawn, Path(scratch) / "sealed.json", folder)
        read = read_track_folders([folder]).recordings
    frame = np.arange(round(drawn["fps"] * drawn["seconds"]))
    return tuple(_add_empty_frames(one, frame, drawn["said"], drawn["noise"]) for one in read)


def _add_empty_frames(one: Recording, frame: np.ndarray, fps: float, noise: float) -> Recording:
    """Add rows for frames in which no ball was observed."""
    places = np.full((len(frame), *one.positions.shape[1:]), np.nan)
    places[one.frame] = one.positions
    return Recording(one.shot, frame, frame / fps, one.bodies, places, np.full(places.shape[:2], noise), TABLE_PLANE)
