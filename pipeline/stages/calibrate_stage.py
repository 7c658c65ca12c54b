"""The calibrate stage: locates the table in the image."""

from __future__ import annotations

from pathlib import Path

from models.core.progress import Progress
from models.core.scene import Scene
from pipeline.engine.stage import Inputs, Stage
from video.io.video_options import CalibrateOptions


def calibrate_stage(options: CalibrateOptions) -> Stage:
    """Build the stage that calibrates the camera.

    Args:
        options: Options of the stage.

    Returns:
        The stage `calibrate`, whose output is a `WithheldScene`.
    """
    return Stage("calibrate", __name__, ("read",), Scene, _locate_table, options)


def _locate_table(inputs: Inputs, options: CalibrateOptions, folder: Path, progress: Progress) -> Scene:
    """Locate the table and calibrate the camera."""
    from pipeline.io.view_profile import parse_view_prior  # slow to import
    from video.calibration.table_finder import calibrate_clip

    prior = parse_view_prior(options.profile) if options.profile else None
    return calibrate_clip(inputs["read"], options, progress, prior)
