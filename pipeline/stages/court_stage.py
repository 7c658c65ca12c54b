"""The court stage: finds a court in the image, and the camera that looks at it."""

from __future__ import annotations

from pathlib import Path

from models.core.court_camera import CourtScene
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from video.io.video_options import CourtOptions


def court_stage(options: CourtOptions) -> Stage:
    """Build the stage that finds a court.

    Args:
        options: Options of the stage.

    Returns:
        The stage `court`, whose output is a `CourtScene`.
    """
    return Stage("court", __name__, ("read",), CourtScene, _locate_court, options)


def _locate_court(inputs: Inputs, options: CourtOptions, folder: Path, progress: Progress) -> CourtScene:
    """Find the court and its camera."""
    from video.calibration.court_finder import locate_court  # slow to import

    return locate_court(inputs["read"], options.sport, options.corners, progress)
