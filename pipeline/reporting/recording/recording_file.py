"""recording.rrd: all layers of a finished run for the rerun viewer."""

from __future__ import annotations

from pathlib import Path

from models.core.detections import Detections
from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.forecast.forecast_values import ForecastFans
from pipeline.engine.atomic_write import replace_file
from pipeline.reporting.recording.forecast_layer import log_forecast_fans
from pipeline.reporting.recording.recorded_shot import build_recorded_shot, finish_stream, open_stream
from pipeline.reporting.recording.stage_layers import (
    log_calibrate_stage,
    log_detect_stage,
    log_fit_stage,
    log_read_stage,
    log_track_stage,
)
from pipeline.reporting.recording.viewer_blueprint import build_blueprint
from video.io.clip import Clip


def write_recording(
    clip: Clip,
    scene: Scene,
    detections: Detections,
    tracks: Tracks,
    fit: Fit,
    forecasts: ForecastFans,
    path: Path,
    title: str,
) -> None:
    """Write the recording of a run, with a blueprint; its timelines are seconds and frames of the source clip.

    Entities: `picture/` in px, `plan/` in m, `plots/` (speed m/s, energy mJ, residual mm), `log/`, `parameters/`
    and `about`; docs/reference/file-formats.md lists them.

    Args:
        clip: The clip.
        scene: Table and camera.
        detections: K detections.
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        forecasts: Fans of predicted paths.
        path: File to write (.rrd).
        title: Name of the recording in the viewer.
    """
    stream = open_stream(clip.digest, title)
    with replace_file(path) as fresh:
        stream.save(fresh, default_blueprint=build_blueprint(clip, scene.table))
        log_read_stage(stream, clip, path.parent)
        log_calibrate_stage(stream, clip, scene)
        log_detect_stage(stream, clip, detections)
        log_track_stage(stream, clip, tracks)
        log_fit_stage(stream, shot := build_recorded_shot(clip, scene, tracks, fit))
        log_forecast_fans(stream, shot, forecasts)
        finish_stream(stream, path)
