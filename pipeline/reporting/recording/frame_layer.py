"""Layers over the clip, in px of its upright picture."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from pipeline.reporting.recording.recorded_shot import Shot
from pipeline.reporting.recording.recording_stream import timeline
from video.io.clip import Clip
from video.io.embedded_clip import playable, re_encoded

SIGMAS = 3.0
"""Standard deviations that the dot of a detection covers."""
LEAST_DOT = 0.75
"""px, below which a dot is not seen."""
RING = 1.15
"""Ball radii: a track's ring stands clear of its ball."""


def log_video(stream: rr.RecordingStream, clip: Clip, folder: Path) -> None:
    """The clip, or a copy that the viewer plays, made in `folder`; the recording holds its bytes."""
    with TemporaryDirectory(prefix=".", dir=folder) as aside:
        asset, stamps = _asset(clip, Path(aside) / "copy.mp4")
    stream.log("picture/video", asset, static=True)
    stamps = np.sort(stamps)[: clip.frame_count]
    times = timeline(clip.t[: len(stamps)], clip.t)
    stream.send_columns("picture/video", times, rr.VideoFrameReference.columns_nanos(stamps))


def _asset(clip: Clip, copy: Path) -> tuple[rr.AssetVideo, NDArray[np.int64]]:
    """The video and the times of its pictures, ns; a file that FFmpeg forgives and the viewer does not is copied."""
    asset = rr.AssetVideo(path=playable(clip, copy))
    try:
        return asset, asset.read_frame_timestamps_nanos()
    except RuntimeError:
        asset = rr.AssetVideo(path=re_encoded(clip, copy))
        return asset, asset.read_frame_timestamps_nanos()


def log_detections(stream: rr.RecordingStream, clip: Clip, detections: Detections) -> None:
    """A dot as large as three standard deviations; sigma (px) and score stand beside it."""
    frames, counts = np.unique(detections.frame, return_counts=True)
    if len(frames):
        radii = np.maximum(SIGMAS * detections.sigma, LEAST_DOT)
        points = rr.Points2D.columns(positions=detections.centre, radii=radii).partition(counts)
        facts = rr.AnyValues.columns(sigma_px=detections.sigma, score=detections.score).partition(counts)
        stream.send_columns("picture/detections", timeline(clip.t[frames], clip.t), [*points, *facts])
    stream.log("picture/detections", rr.Points2D.from_fields(colors=[255, 255, 255, 160]), static=True)


def log_tracks(stream: rr.RecordingStream, clip: Clip, tracks: Tracks, colours: ByteArray) -> None:
    """A ring about each ball where it was seen."""
    seen = tracks.observed
    angle = np.linspace(0, 2 * np.pi, 33)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for k, ball in enumerate(tracks.ids):
        rows = np.flatnonzero(seen[:, k])
        rings = tracks.px[rows, k, None, :] + RING * tracks.radius_px[rows, k, None, None] * circle
        entity = f"picture/tracks/{ball}"
        if len(rows):
            strips = rr.LineStrips2D.columns(strips=list(rings.astype(np.float32)))
            stream.send_columns(entity, timeline(tracks.t, clip.t), strips.partition(seen[:, k].astype(np.int64)))
        look = {"colors": colours[k], "radii": rr.Radius.ui_points(1.0), "labels": [ball]}
        stream.log(entity, rr.LineStrips2D.from_fields(**look), static=True)


def log_paths(stream: rr.RecordingStream, shot: Shot) -> None:
    """The whole fitted path of each ball that moves, faint; over it what lies before now, bright."""
    for k in np.flatnonzero(shot.moves):
        t, xy = shot.way(int(k))
        px = shot.in_pictures(xy)
        stream.send_columns(
            f"picture/paths/{shot.ids[k]}", _pictures(shot.clip, len(px)), rr.LineStrips2D.columns(strips=list(px))
        )
        faint = {"colors": [*shot.lines[k], 90], "radii": rr.Radius.ui_points(0.75)}
        stream.log(f"picture/paths/{shot.ids[k]}", rr.LineStrips2D.from_fields(**faint), static=True)
        log_past(stream, f"picture/past/{shot.ids[k]}", shot, t, xy, int(k), in_picture=True)


def log_past(
    stream: rr.RecordingStream, entity: str, shot: Shot, t: FloatArray, xy: FloatArray, ball: int, *, in_picture: bool
) -> None:
    """At every picture the way of a ball until then, of its points (n, 2) m at t (n,) s."""
    shown = shot.clip.t
    now = shot.fit.trajectory.at(shown).xy[:, ball]
    there = np.flatnonzero(np.isfinite(now[:, 0]) & (shown > t[0]))
    ways = [np.vstack([xy[t < shown[k]], now[k]]) for k in there]
    if in_picture:
        camera, radius = shot.scene.camera, shot.scene.table.ball_radius
        ways = [camera.to_pixels(way, radius, int(k)) for k, way in zip(there, ways, strict=True)]
    colour = (shot.lines if in_picture else shot.plotted)[ball]
    look = {"colors": colour, "radii": rr.Radius.ui_points(1.5)}
    stream.log(entity, rr.LineStrips2D.from_fields(**look), static=True)
    if len(there):
        strips = rr.LineStrips2D.columns(strips=[way.astype(np.float32) for way in ways])
        stream.send_columns(entity, timeline(shown[there], shown), strips)


def _pictures(clip: Clip, count: int) -> list[rr.TimeColumn]:
    """The times of the first `count` pictures."""
    return timeline(clip.t[:count], clip.t)
