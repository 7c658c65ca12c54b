"""The cases of `billiards_gap.py`: the kinds of the blind check, and harder ones, as recordings.

What is withheld and how strong it is says `pipeline/experiments/gapcheck/billiards_cases.py`, how tables are played on and filmed
`worlds/billiards_table.py`: `trueroll gapcheck --fps 62.5` sees the same shots of the same kind and seed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from models.estimation.gap_scenes.gap_scene import Recording
from pipeline.experiments.gapcheck.billiards_cases import BILLIARDS, FROM_NOTHING, SINGLE, BilliardsKind
from pipeline.experiments.gapcheck.billiards_strengths import Effects
from pipeline.experiments.gapcheck.blind_case import play_drawn
from pipeline.io.track_folder import read_track_folders

FPS = 62.5
"""Pictures a second: 16 samples of the world."""
NEAR = (4.0, 6.0)
"""standard deviations of a strength just above the noise."""


@dataclass(frozen=True, slots=True)
class Case:
    """A kind, and how it is harder than usual."""

    kind: BilliardsKind
    shots: int = 12
    fps: float = FPS
    noise: float = 1.0
    """times what is usual."""
    harder: Literal["", "weak", "slow", "few", "noisy"] = ""
    """weak: NEAR standard deviations, all else adjusted (billiards_gap.py)."""

    @property
    def name(self) -> str:
        return self.kind.case


def _harder() -> Iterator[Case]:
    """Of single effects."""
    kinds = {kind.case: kind for kind in BILLIARDS}

    def called(name: str, words: str) -> BilliardsKind:
        return replace(kinds[name], case=f"{name}, {words}")

    yield from (Case(called(name, "weak"), harder="weak") for name in FROM_NOTHING)
    slow = f"{FPS / 2:g} pictures a second"
    yield from (Case(called(name, slow), fps=FPS / 2, harder="slow") for name in SINGLE)
    yield from (Case(called(name, "5 shots"), shots=5, harder="few") for name in SINGLE)
    yield from (Case(called(name, "1 px"), noise=1.0 / 0.3, harder="noisy") for name in SINGLE)


CASES = {case.name: case for case in (*map(Case, BILLIARDS), *_harder())}


def recordings(case: Case, seed: int, strength: float = 1.0) -> tuple[tuple[Recording, ...], Effects]:
    """All shots of one table as a camera sees them, and what acted: what the simulator lacks, times `strength`."""
    drawn = case.kind.drawn(seed, case.shots, case.fps)
    drawn["noise"] *= case.noise
    effects: Effects = drawn["effects"]
    for name in case.kind.lacks if strength != 1.0 else ():
        effects[name] = {parameter: strength * value for parameter, value in effects[name].items()}
    return _played(case.kind, drawn), effects


def _played(kind: BilliardsKind, drawn: dict[str, Any]) -> tuple[Recording, ...]:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "case"
        play_drawn(kind, drawn, Path(scratch) / "sealed.json", folder)
        read = read_track_folders([folder]).recordings
    frame = np.arange(round(drawn["fps"] * drawn["seconds"]))
    return tuple(_of_all_pictures(one, frame, drawn["said"], drawn["noise"]) for one in read)


def _of_all_pictures(one: Recording, frame: np.ndarray, fps: float, noise: float) -> Recording:
    """A recording with a row also for pictures in which no ball was seen."""
    places = np.full((len(frame), *one.places.shape[1:]), np.nan)
    places[one.frame] = one.places
    return Recording(one.shot, frame, frame / fps, one.bodies, places, np.full(places.shape[:2], noise))
