"""The track stage: links detections to tracks."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.options import TrackOptions
from models.core.progress import Progress
from models.core.tracks import Tracks
from pipeline.engine.stage import Inputs, Stage, describe_facts


def track_stage(options: TrackOptions, corrections: Corrections = NO_CORRECTIONS, detections: str = "detect") -> Stage:
    """Build the stage that tracks balls.

    Args:
        options: Options of the stage.
        corrections: What a person corrected.
        detections: Stage whose detections are tracked.

    Returns:
        The stage `track`, whose output is `Tracks`.
    """
    own = Corrections(balls=corrections.balls, tracks=corrections.tracks)
    run = partial(_build_tracks, own, detections)
    return Stage("track", __name__, ("read", "calibrate", detections), Tracks, run, options, describe_facts(own))


def _build_tracks(
    corrections: Corrections, detections: str, inputs: Inputs, options: TrackOptions, folder: Path, progress: Progress
) -> Tracks:
    """Link the detections of all distinct frames to tracks, and look what each ball is."""
    from detectors.measurement.ball_paint import look_at_balls  # slow to import
    from models.estimation.hand_marks.resolved_marks import find_tracked_ball
    from models.tracking.ball_names import correct_looks
    from models.tracking.build_tracks import build_tracks

    clip, scene = inputs["read"], inputs["calibrate"]
    frames, times = clip.distinct_frames, clip.times_of(clip.distinct_frames)
    tracks = build_tracks(inputs[detections], frames, times, scene, options, progress, corrections)
    classified = [find_tracked_ball(tracks, edit.ball) for edit in corrections.tracks if edit.kind == "class"]
    looks = look_at_balls(clip, scene, tracks, [ball for ball in classified if ball is not None])
    return replace(tracks, looks=correct_looks(tracks.ids, looks, json.loads(options.looks or "{}")))
