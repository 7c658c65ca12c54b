"""recording.rrd: all layers of a finished run."""

from __future__ import annotations

from pathlib import Path

from models.core.detections import Detections
from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.forecast.forecast_values import Foresights
from pipeline.engine.atomic_write import aside
from pipeline.reporting.recording.forecast_layer import log_fans
from pipeline.reporting.recording.recorded_shot import shot_of
from pipeline.reporting.recording.recording_stream import finish, open_stream
from pipeline.reporting.recording.stage_layers import log_detected, log_fitted, log_found_table, log_read, log_tracked
from pipeline.reporting.recording.viewer_blueprint import blueprint
from video.io.clip import Clip


def write_recording(
    clip: Clip,
    scene: Scene,
    detections: Detections,
    tracks: Tracks,
    fit: Fit,
    foresights: Foresights,
    path: Path,
    title: str,
) -> None:
    """Write `path` (.rrd), named `title`, with a blueprint; timelines are seconds of the source clip and its frames.

    Entities: `picture/` in px, `plan/` in m, `plots/` (speed m/s, energy mJ, residual mm), `log/`, `parameters/`
    and `about`; docs/formats.md lists them.
    """
    stream = open_stream(clip.digest, title)
    with aside(path) as fresh:
        stream.save(fresh, default_blueprint=blueprint(clip, scene.table))
        log_read(stream, clip, path.parent)
        log_found_table(stream, clip, scene)
        log_detected(stream, clip, detections)
        log_tracked(stream, clip, tracks)
        log_fitted(stream, shot := shot_of(clip, scene, tracks, fit))
        log_fans(stream, shot, foresights)
        finish(stream, path)
