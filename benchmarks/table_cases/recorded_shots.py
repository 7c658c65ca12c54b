"""Recorded three-cushion shots as a track folder, with their cached fits."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from benchmarks.support.run_folder import ROOT
from models.core.contact_graph import JointSolution
from models.core.errors import TrackError
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from pipeline.actions.fit_table import prepare_shot
from pipeline.engine.result_cache import ResultCache
from pipeline.io.kept_values import explain_tracks
from pipeline.io.observed_shot import read_observed_shot

SOURCE = ROOT.parent / "shared" / "data" / "physics" / "recorded_carom" / "shots.csv"
SCENE = {
    "scene": "billiards", "units": "m", "fps": 50, "ball_radius": 0.03075,
    "table": {"length": 2.84, "width": 1.42, "pockets": False, "name": "carom", "game": "carom"},
}  # fmt: skip
# Joint fit, and tracks with realistic sigmas.
Shot = tuple[JointSolution, Tracks]


def prepare_folder(work: Path) -> Path:
    """Write the recorded shots as a track folder."""
    folder = work / "tracks"
    folder.mkdir(parents=True, exist_ok=True)
    with SOURCE.open(newline="") as source, (folder / "tracks.csv").open("w", newline="") as target:
        rows = csv.writer(target, lineterminator="\n")
        rows.writerow(("shot", "frame", "t", "id", "x", "y"))
        for row in csv.DictReader(source):
            frame = round(float(row["t"]) * SCENE["fps"])  # type: ignore[operator]
            rows.writerow((row["shot"], frame, row["t"], row["id"], row["x"], row["y"]))
    (folder / "scene.json").write_text(json.dumps(SCENE) + "\n")
    return folder


def prepare_shots(numbers: Iterable[int], folder: Path, cache: ResultCache) -> tuple[list[Shot], Table]:
    """Fit some shots; also return their table."""
    read = [read_observed_shot(folder, number)[:2] for number in numbers]
    fits = []
    for tracks, scene in read:
        try:
            fits.append(prepare_shot(explain_tracks(tracks, scene, cache)))
        except TrackError as refusal:
            print(refusal, file=sys.stderr)
    return fits, read[0][1].table


def interpolate_place(tracks: Tracks, ball: int, t: float) -> FloatArray:
    """Return the place (2,) m of a ball at t (s) between its samples."""
    rows = np.flatnonzero(tracks.is_observed[:, ball])
    return np.array([np.interp(t, tracks.t[rows], tracks.xy[rows, ball, k]) for k in (0, 1)])


def list_contact_times(
    tracks: Tracks, scene: Scene, cache: ResultCache, ball: int, kinds: tuple[str, ...] = ("cushion",)
) -> list[float]:
    """List the times (s) of the contacts of a ball by the fit of its whole shot."""
    whole = explain_tracks(tracks, scene, cache).solution
    if whole is None:
        return []
    return sorted(one.t for one in whole.graph.contacts if one.kind in kinds and ball in whole.graph.balls_at(one))
