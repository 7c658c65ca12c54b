"""What each stage of the chain adds to a recording, finished or live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from models.detections import Detections
from models.scene import Scene
from models.tracks import Tracks
from pipeline.recording import words
from pipeline.recording.events import log_events
from pipeline.recording.picture import log_detections, log_paths, log_tracks, log_video
from pipeline.recording.plan import log_balls, log_residuals, log_table, log_ways
from pipeline.recording.plots import log_plots
from pipeline.recording.shot import Shot
from video.clip import Clip
from video.palette import ball_colour, legible


def log_read(stream: rr.RecordingStream, clip: Clip, folder: Path) -> None:
    """The clip; `folder` is where a copy may be made that the viewer plays."""
    log_video(stream, clip, folder)
    words.log_chain(stream, clip, "read", words.of_clip(clip))


def log_found_table(stream: rr.RecordingStream, clip: Clip, scene: Scene) -> None:
    """The table."""
    log_table(stream, scene.table)
    words.log_chain(stream, clip, "calibrate", words.of_scene(scene))


def log_detected(stream: rr.RecordingStream, clip: Clip, detections: Detections) -> None:
    """Every ball in every picture."""
    log_detections(stream, clip, detections)
    words.log_chain(stream, clip, "detect", words.of_detections(detections))


def log_tracked(stream: rr.RecordingStream, clip: Clip, tracks: Tracks) -> None:
    """Which ball is which."""
    seen = [legible(ball_colour(*ball)) for ball in zip(tracks.kinds, tracks.colour, strict=True)]
    log_tracks(stream, clip, tracks, np.array(seen, dtype=np.uint8).reshape(-1, 3))
    words.log_chain(stream, clip, "track", words.of_tracks(tracks))


def log_fitted(stream: rr.RecordingStream, shot: Shot) -> None:
    """Motion, events, parameters, trust."""
    log_paths(stream, shot)
    log_ways(stream, shot)
    log_balls(stream, shot)
    log_residuals(stream, shot)
    log_plots(stream, shot)
    log_events(stream, shot)
    words.log_parameters(stream, shot.fit)
    words.log_about(stream, shot)
    words.log_chain(stream, shot.clip, "fit", words.of_fit(shot.clip, shot.fit))
