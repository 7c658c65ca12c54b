"""recording.rrd: all layers of a finished run."""

from __future__ import annotations

from pathlib import Path

from models.detections import Detections
from models.fit import Fit
from models.forecast.foresight import Foresights
from models.scene import Scene
from models.tracks import Tracks
from pipeline.publish import aside
from pipeline.recording.blueprint import blueprint
from pipeline.recording.fans import log_fans
from pipeline.recording.layers import log_detected, log_fitted, log_found_table, log_read, log_tracked
from pipeline.recording.shot import shot_of
from pipeline.recording.stream import finish, open_stream
from video.clip import Clip


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
