"""What each stage of the chain adds to a recording, finished or live."""

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
from pipeline.reporting.recording.plan_layer import log_balls, log_residuals, log_table, log_ways
from pipeline.reporting.recording.plot_layer import log_plots
from pipeline.reporting.recording.recorded_shot import Shot
from video.drawing.palette import ball_colour, legible
from video.io.clip import Clip


def log_read(stream: rr.RecordingStream, clip: Clip, folder: Path) -> None:
    """The clip; `folder` is where a copy may be made that the viewer plays."""
    log_video(stream, clip, folder)
    text_layer.log_chain(stream, clip, "read", text_layer.of_clip(clip))


def log_found_table(stream: rr.RecordingStream, clip: Clip, scene: Scene) -> None:
    """The table."""
    log_table(stream, scene.table)
    text_layer.log_chain(stream, clip, "calibrate", text_layer.of_scene(scene))


def log_detected(stream: rr.RecordingStream, clip: Clip, detections: Detections) -> None:
    """Every ball in every picture."""
    log_detections(stream, clip, detections)
    text_layer.log_chain(stream, clip, "detect", text_layer.of_detections(detections))


def log_tracked(stream: rr.RecordingStream, clip: Clip, tracks: Tracks) -> None:
    """Which ball is which."""
    seen = [legible(ball_colour(*ball)) for ball in zip(tracks.kinds, tracks.colour, strict=True)]
    log_tracks(stream, clip, tracks, np.array(seen, dtype=np.uint8).reshape(-1, 3))
    text_layer.log_chain(stream, clip, "track", text_layer.of_tracks(tracks))


def log_fitted(stream: rr.RecordingStream, shot: Shot) -> None:
    """Motion, events, parameters, trust."""
    log_paths(stream, shot)
    log_ways(stream, shot)
    log_balls(stream, shot)
    log_residuals(stream, shot)
    log_plots(stream, shot)
    log_events(stream, shot)
    text_layer.log_parameters(stream, shot.fit)
    text_layer.log_about(stream, shot)
    text_layer.log_chain(stream, shot.clip, "fit", text_layer.of_fit(shot.clip, shot.fit))
