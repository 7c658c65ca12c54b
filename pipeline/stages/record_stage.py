"""The record stage: writes the recording for the rerun viewer."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from models.core.detections import MarkedDetections
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.shot import Shot
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.run_views import list_view_inputs, view_inputs


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """Options of the recording."""

    title: str
    """Name of the clip in the viewer."""
    fit: FitOptions
    """Options of the explanation."""
    detections: str = "detect"
    """Stage whose detections are shown."""


def record_stage(options: RecordOptions) -> Stage:
    """Build the stage that writes the recording.

    Args:
        options: Options of the stage.

    Returns:
        The stage `record`, whose output is a folder with recording.rrd.
    """
    needs = ("read", options.detections, *list_view_inputs(options.fit))
    return Stage("record", __name__, needs, None, _record_layers, options)


def _record_layers(inputs: Inputs, options: RecordOptions, folder: Path, progress: Progress) -> None:
    """Write recording.rrd."""
    os.environ.setdefault("RUST_LOG", "off")  # read at import: rerun would print what it raises
    from pipeline.reporting.recording.stage_layers import write_recording  # slow to import

    shot: Shot = inputs["explain"]
    shown = inputs[options.detections]
    detections = shown.detections if isinstance(shown, MarkedDetections) else shown
    write_recording(
        inputs["read"], shot.scene, detections, shot.tracks, view_inputs(inputs, options.fit),
        folder / "recording.rrd", options.title,
    )  # fmt: skip
