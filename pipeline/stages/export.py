"""Export: the tables of a run as csv and json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from models.progress import Progress
from pipeline.stage import Inputs, Stage
from pipeline.tables import write_events, write_scene, write_tracks, write_trajectory


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Nothing to choose: the files are fixed."""


def export_stage() -> Stage:
    return Stage("export", __name__, ("read", "calibrate", "track", "fit"), None, _run, ExportOptions())


def _run(inputs: Inputs, options: ExportOptions, folder: Path, progress: Progress) -> None:
    scene, tracks, fit = inputs["calibrate"], inputs["track"], inputs["fit"]
    write_tracks(scene, tracks, fit, folder / "tracks.csv")
    write_events(fit.events, folder / "events.csv")
    write_scene(inputs["read"], scene, tracks, fit, folder / "scene.json")
    progress(0.5)
    write_trajectory(fit.trajectory, folder / "trajectory.csv")
