"""The export stage: writes the tables of a run as csv and json."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path

from detectors.detect_options import DetectOptions
from detectors.select_detector import note_selection
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.shot import Shot
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.csv_tables import write_events
from pipeline.io.run_tables import write_scene, write_tracks, write_trajectory
from pipeline.io.run_views import list_view_inputs, view_inputs
from pipeline.io.saved_shot import write_shot


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of the tables."""

    detect: DetectOptions
    """Options of the detection, which scene.json notes."""
    fit: FitOptions
    """Options of the explanation, which the saved shot notes."""


def export_stage(detect: DetectOptions, fit: FitOptions) -> Stage:
    """Build the stage that writes the tables.

    Args:
        detect: Options of the detection, which scene.json notes.
        fit: Options of the explanation.

    Returns:
        The stage `export`, whose output is a folder of files.
    """
    options = ExportOptions(detect, fit)
    return Stage("export", __name__, ("read", *list_view_inputs(fit)), None, _write_tables, options)


def _write_tables(inputs: Inputs, options: ExportOptions, folder: Path, progress: Progress) -> None:
    """Write the saved shot, and its exports tracks.csv, events.csv, scene.json and trajectory.csv."""
    shot: Shot = inputs["explain"]
    scene, tracks, fit = note_selection(shot.scene, options.detect), shot.tracks, view_inputs(inputs, options.fit)
    write_shot(shot, asdict(replace(options.fit, laws=False, profile="")), version("trueroll"), folder)
    write_tracks(scene, tracks, fit, folder / "tracks.csv")
    write_events(fit.events, folder / "events.csv")
    write_scene(inputs["read"], scene, tracks, fit, folder / "scene.json", shot.corrections)
    progress(0.5)
    write_trajectory(fit.trajectory, folder / "trajectory.csv")
