"""Export: the tables of a run as csv and json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from detectors.options import DetectOptions
from detectors.select_detector import with_choice_noted
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.run_tables import write_events, write_scene, write_tracks, write_trajectory


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What the files say of how the balls were found."""

    detect: DetectOptions


def export_stage(detect: DetectOptions) -> Stage:
    return Stage("export", __name__, ("read", "calibrate", "track", "fit"), None, _run, ExportOptions(detect))


def _run(inputs: Inputs, options: ExportOptions, folder: Path, progress: Progress) -> None:
    scene, tracks, fit = with_choice_noted(inputs["calibrate"], options.detect), inputs["track"], inputs["fit"]
    write_tracks(scene, tracks, fit, folder / "tracks.csv")
    write_events(fit.events, folder / "events.csv")
    write_scene(inputs["read"], scene, tracks, fit, folder / "scene.json")
    progress(0.5)
    write_trajectory(fit.trajectory, folder / "trajectory.csv")
