"""The export stage: writes the tables of a run as csv and json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from detectors.detect_options import DetectOptions
from detectors.select_detector import note_selection
from models.core.by_hand.corrections import NO_CORRECTIONS, Corrections
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.run_tables import write_events, write_scene, write_tracks, write_trajectory


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of the tables."""

    detect: DetectOptions
    """Options of the detection, which scene.json notes."""
    corrections: Corrections = NO_CORRECTIONS
    """What a person corrected, which scene.json notes."""


def export_stage(detect: DetectOptions, corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that writes the tables.

    Args:
        detect: Options of the detection, which scene.json notes.
        corrections: What a person corrected, which scene.json notes.

    Returns:
        The stage `export`, whose output is a folder of files.
    """
    options = ExportOptions(detect, corrections)
    return Stage("export", __name__, ("read", "calibrate", "track", "fit"), None, _write_tables, options)


def _write_tables(inputs: Inputs, options: ExportOptions, folder: Path, progress: Progress) -> None:
    """Write tracks.csv, events.csv, scene.json and trajectory.csv."""
    scene, tracks, fit = note_selection(inputs["calibrate"], options.detect), inputs["track"], inputs["fit"]
    write_tracks(scene, tracks, fit, folder / "tracks.csv")
    write_events(fit.events, folder / "events.csv")
    write_scene(inputs["read"], scene, tracks, fit, folder / "scene.json", options.corrections)
    progress(0.5)
    write_trajectory(fit.trajectory, folder / "trajectory.csv")
