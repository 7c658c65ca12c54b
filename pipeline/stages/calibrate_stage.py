"""Calibrate: the table in the picture."""

from __future__ import annotations

from pathlib import Path

from models.core.progress import Progress
from models.core.scene import Scene
from pipeline.engine.stage import Inputs, Stage
from video.io.options import CalibrateOptions


def calibrate_stage(options: CalibrateOptions) -> Stage:
    return Stage("calibrate", __name__, ("read",), Scene, _run, options)


def _run(inputs: Inputs, options: CalibrateOptions, folder: Path, progress: Progress) -> Scene:
    from video.calibration.table_finder import find_scene  # slow to import, and not needed while cached

    return find_scene(inputs["read"], options, progress)
