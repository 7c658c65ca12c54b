"""Track: which detection is which ball."""

from __future__ import annotations

from pathlib import Path

from models.core.options import TrackOptions
from models.core.progress import Progress
from models.core.tracks import Tracks
from pipeline.engine.stage import Inputs, Stage


def track_stage(options: TrackOptions) -> Stage:
    return Stage("track", __name__, ("read", "calibrate", "detect"), Tracks, _run, options)


def _run(inputs: Inputs, options: TrackOptions, folder: Path, progress: Progress) -> Tracks:
    from models.tracking.build_tracks import associate  # slow to import, and not needed while cached

    clip = inputs["read"]
    return associate(
        inputs["detect"], clip.distinct, clip.t[clip.distinct], inputs["calibrate"], options, progress
    )  # fmt: skip
