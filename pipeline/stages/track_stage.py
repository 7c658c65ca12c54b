"""The track stage: links detections to tracks."""

from __future__ import annotations

from pathlib import Path

from models.core.options import TrackOptions
from models.core.progress import Progress
from models.core.tracks import Tracks
from pipeline.engine.stage import Inputs, Stage


def track_stage(options: TrackOptions) -> Stage:
    """Build the stage that tracks balls.

    Args:
        options: Options of the stage.

    Returns:
        The stage `track`, whose output is `Tracks`.
    """
    return Stage("track", __name__, ("read", "calibrate", "detect"), Tracks, _build_tracks, options)


def _build_tracks(inputs: Inputs, options: TrackOptions, folder: Path, progress: Progress) -> Tracks:
    """Link the detections of all distinct frames to tracks."""
    from models.tracking.build_tracks import build_tracks  # slow to import

    clip = inputs["read"]
    return build_tracks(
        inputs["detect"], clip.distinct_frames, clip.t[clip.distinct_frames], inputs["calibrate"], options, progress
    )  # fmt: skip
