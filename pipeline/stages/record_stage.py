"""Record: everything on one timeline for the rerun viewer."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What the recording says of itself."""

    title: str
    """Name of the clip, as shown in the viewer."""


def record_stage(options: RecordOptions) -> Stage:
    return Stage("record", __name__, ("read", "calibrate", "detect", "track", "fit", "forecast"), None, _run, options)


def _run(inputs: Inputs, options: RecordOptions, folder: Path, progress: Progress) -> None:
    os.environ.setdefault("RUST_LOG", "off")  # rerun would print what it raises; it reads this when it is imported
    from pipeline.reporting.recording.recording_file import (
        write_recording,  # slow to import, and not needed while cached
    )

    write_recording(
        inputs["read"], inputs["calibrate"], inputs["detect"], inputs["track"], inputs["fit"], inputs["forecast"],
        folder / "recording.rrd", options.title,
    )  # fmt: skip
