"""A case from end to end: a world plays behind a seal, the diagnosis sees its track folder, then the seal is opened."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import Report
from models.core.errors import TruerollError
from models.estimation.gap_scenes.gap_scene import GapScene, Recording
from models.numerics.executor import ALONE, Crew
from pipeline.experiments.gapcheck.case_kind import Kind
from pipeline.experiments.gapcheck.gap_oracle import oracle_of
from pipeline.io.gap_files import write_gap
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import open_scene

WORLDS = Path(__file__).resolve().parents[3] / "worlds"
Answer = Literal["right", "group", "unknown", "none", "undecidable", "wrong"]


class WorldFailed(TruerollError):
    """A world that did not play."""


@dataclass(frozen=True, slots=True)
class Opened:
    """A case whose seal was opened after its report was written."""

    kind: Kind
    seed: int
    answer: Answer
    named: tuple[str, ...]
    """what the report names; none or unknown where that is its verdict."""
    probability: float
    """of the answer."""
    closed: float
    """of the gap; NaN where that is not resolved."""
    interval: tuple[float, float]
    oracle: float
    """what a simulator closes that has the withheld effects from the start; NaN where it is not resolved or foreign."""


def play(kind: Kind, seed: int, shots: int, fps: float, sealed: Path, folder: Path) -> None:
    """Let the world of a kind write a track folder; what acts is written to `sealed` alone."""
    play_drawn(kind, kind.drawn(seed, shots, fps), sealed, folder)


def play_drawn(kind: Kind, drawn: Mapping[str, Any], sealed: Path, folder: Path) -> None:
    """The same, of an experiment that was drawn already."""
    sealed.write_text(json.dumps(drawn), encoding="utf-8")
    command = [sys.executable, str(WORLDS / f"{kind.world}.py"), str(sealed), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise WorldFailed(f"the world of {kind.name!r} did not play: {said[-1] if said else 'no reason given'}")


def judge(kind: Kind, seed: int, folder: Path, workers: Crew = ALONE) -> Opened:
    """Diagnose a track folder, write its report, and only then look at what was withheld."""
    read = read_track_folders([folder])
    scene = kind.simulator(open_scene(read))
    report = diagnose(scene, read.recordings, seed, crew=workers)
    write_gap(report, folder / "gap")
    told = report.gap.closing
    names = report.effects or (report.verdict,)
    said = answer(kind, report)
    if kind.trap and report.effects and said == "right" and not told_apart(kind, scene, read.recordings):
        said = "wrong"
    return Opened(
        kind, seed, said, names, report.probability, told.closed if told.resolved else np.nan, told.interval,
        _oracle(kind, scene, read.recordings, report),
    )  # fmt: skip


def answer(kind: Kind, report: Report) -> Answer:
    """How a report does against what was withheld; of a trap, as if its name were no guess."""
    if kind.trap and kind.withheld and not report.effects:
        return "right"
    if report.verdict == "undecidable":
        return "undecidable"
    if report.verdict == "unknown":
        return "right" if kind.foreign else "unknown"
    if report.verdict == "none":
        return "none" if kind.withheld else "right"
    if report.verdict == "group":
        group = set(report.candidates[0].group)
        return "group" if kind.withheld and (kind.withheld <= group or group & kind.family) else "wrong"
    return "right" if kind.is_named_by(frozenset(report.effects)) and not kind.foreign else "wrong"


def told_apart(kind: Kind, scene: GapScene, recordings: tuple[Recording, ...]) -> bool:
    """Whether somebody who knows what is missing can tell it from what is taken for it."""
    partners = {name for one in scene.effects if one.name in kind.withheld for name in one.partners}
    oracle = oracle_of(scene, recordings)
    truth = oracle.knowing(kind.withheld)
    return all(oracle.tells(truth, frozenset({name})) for name in sorted(partners - set(scene.assumed)))


def _oracle(kind: Kind, scene: GapScene, recordings: tuple[Recording, ...], report: Report) -> float:
    """The closed part of the gap for whoever knows what is missing."""
    if not kind.withheld or kind.foreign or not report.gap.closing.resolved:
        return np.nan
    oracle = oracle_of(scene, recordings)
    names = frozenset(oracle.question.candidates) & (kind.withheld | kind.family)
    told = oracle.closes(oracle.knowing(names, kind.forms), oracle.held_out)
    return told.closed if told.resolved else np.nan
