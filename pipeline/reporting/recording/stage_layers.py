"""Layers that each stage of the chain adds to a recording, finished or live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from models.core.detections import Detections
from models.core.scene import Scene
from models.core.tracks import Tracks
from pipeline.reporting.recording import text_layer
from pipeline.reporting.recording.event_layer import log_events
from pipeline.reporting.recording.frame_layer import log_detections, log_paths, log_tracks, log_video
from pipeline.reporting.recording.plan_layer import log_fitted_balls, log_plan_paths, log_residuals, log_table
from pipeline.reporting.recording.plot_layer import log_plots
from pipeline.reporting.recording.recorded_shot import RecordedShot
from video.drawing.palette import ball_colour, lighten_for_text
from video.io.clip import Clip


def log_read_stage(stream: rr.RecordingStream, clip: Clip, folder: Path) -> None:
    """Log the clip; `folder` is the place of a temporary copy that the viewer can play."""
    log_video(stream, clip, folder)
    text_layer.log_stage_lines(stream, clip, "read", text_layer.describe_clip(clip))


def log_calibrate_stage(stream: rr.RecordingStream, clip: Clip, scene: Scene) -> None:
    """Log the table."""
    log_table(stream, scene.table)
    text_layer.log_stage_lines(stream, clip, "calibrate", text_layer.describe_scene(scene))


def log_detect_stage(stream: rr.RecordingStream, clip: Clip, detections: Detections) -> None:
    """Log the detections of all frames."""
    log_detections(stream, clip, detections)
    text_layer.log_stage_lines(stream, clip, "detect", text_layer.describe_detections(detections))


def log_track_stage(stream: rr.RecordingStream, clip: Clip, tracks: Tracks) -> None:
    """Log the tracks of all balls."""
    colours = [lighten_for_text(ball_colour(*ball)) for ball in zip(tracks.kinds, tracks.colour, strict=True)]
    log_tracks(stream, clip, tracks, np.array(colours, dtype=np.uint8).reshape(-1, 3))
    text_layer.log_stage_lines(stream, clip, "track", text_layer.describe_tracks(tracks))


def log_fit_stage(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log motion, events, parameters and trust level."""
    log_paths(stream, shot)
    log_plan_paths(stream, shot)
    log_fitted_balls(stream, shot)
    log_residuals(stream, shot)
    log_plots(stream, shot)
    log_events(stream, shot)
    text_layer.log_parameters(stream, shot.fit)
    text_layer.log_about(stream, shot)
    text_layer.log_stage_lines(stream, shot.clip, "fit", text_layer.describe_fit(shot.clip, shot.fit))
