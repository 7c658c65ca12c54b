"""Layers over the clip in a recording, in px of its upright frames."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from models.core.detections import Detections
from models.core.tracks import Tracks
from models.core.typing import ByteArray, FloatArray
from pipeline.reporting.recording.recorded_shot import RecordedShot, build_time_columns
from video.io.clip import Clip
from video.io.playback_copy import ensure_playable, re_encode_clip

# Radius of the disc of a detection, standard deviations.
DOT_SIGMAS = 3.0
# Least radius of a disc that is visible, px.
MIN_DOT_RADIUS = 0.75
# Radius of the ring of a track, ball radii; more than one, so that it does not cover the ball.
RING_RADII = 1.15


def log_video(stream: rr.RecordingStream, clip: Clip, folder: Path) -> None:
    """Log the clip, or a re-encoded copy that the viewer can play, made in `folder`; the recording embeds it."""
    with TemporaryDirectory(prefix=".", dir=folder) as aside:
        asset, stamps = _load_video_asset(clip, Path(aside) / "copy.mp4")
    stream.log("picture/video", asset, static=True)
    stamps = np.sort(stamps)[: clip.frame_count]
    times = build_time_columns(clip.t[: len(stamps)], clip)
    stream.send_columns("picture/video", times, rr.VideoFrameReference.columns_nanos(stamps))


def _load_video_asset(clip: Clip, copy: Path) -> tuple[rr.AssetVideo, NDArray[np.int64]]:
    """Load the video and the times of its frames, ns; re-encode a file that the viewer cannot parse."""
    asset = rr.AssetVideo(path=ensure_playable(clip, copy))
    try:
        return asset, asset.read_frame_timestamps_nanos()
    except RuntimeError:
        asset = rr.AssetVideo(path=re_encode_clip(clip, copy))
        return asset, asset.read_frame_timestamps_nanos()


def log_detections(stream: rr.RecordingStream, clip: Clip, detections: Detections) -> None:
    """Log each detection as a disc of three standard deviations, with sigma (px) and score."""
    frames, counts = np.unique(detections.frame, return_counts=True)
    if len(frames):
        radii = np.maximum(DOT_SIGMAS * detections.sigma, MIN_DOT_RADIUS)
        points = rr.Points2D.columns(positions=detections.centre, radii=radii).partition(counts)
        facts = rr.AnyValues.columns(sigma_px=detections.sigma, score=detections.score).partition(counts)
        stream.send_columns("picture/detections", build_time_columns(clip.times_of(frames), clip), [*points, *facts])
    stream.log("picture/detections", rr.Points2D.from_fields(colors=[255, 255, 255, 160]), static=True)


def log_tracks(stream: rr.RecordingStream, clip: Clip, tracks: Tracks, colours: ByteArray) -> None:
    """Log a ring around each ball in the frames where it was observed; colours (N, 3)."""
    is_observed = tracks.is_observed
    angle = np.linspace(0, 2 * np.pi, 33)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for k, ball in enumerate(tracks.ids):
        rows = np.flatnonzero(is_observed[:, k])
        rings = tracks.px[rows, k, None, :] + RING_RADII * tracks.radius_px[rows, k, None, None] * circle
        entity = f"picture/tracks/{ball}"
        if len(rows):
            strips = rr.LineStrips2D.columns(strips=list(rings.astype(np.float32)))
            stream.send_columns(
                entity, build_time_columns(tracks.t, clip), strips.partition(is_observed[:, k].astype(np.int64))
            )
        look = {"colors": colours[k], "radii": rr.Radius.ui_points(1.0), "labels": [tracks.looks[k].name]}
        stream.log(entity, rr.LineStrips2D.from_fields(**look), static=True)


def log_paths(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log the whole fitted path of each moving ball, faint, and its path up to the current time, bright."""
    for k in np.flatnonzero(shot.is_moving):
        t, xy = shot.path_points(int(k))
        px = shot.to_frame_pixels(xy)
        stream.send_columns(
            f"picture/paths/{shot.ids[k]}",
            _frame_time_columns(shot.clip, len(px)),
            rr.LineStrips2D.columns(strips=list(px)),
        )
        faint = {"colors": [*shot.frame_colours[k], 90], "radii": rr.Radius.ui_points(0.75)}
        stream.log(f"picture/paths/{shot.ids[k]}", rr.LineStrips2D.from_fields(**faint), static=True)
        log_path_so_far(stream, f"picture/past/{shot.ids[k]}", shot, t, xy, int(k), in_image=True)


def log_path_so_far(
    stream: rr.RecordingStream,
    entity: str,
    shot: RecordedShot,
    t: FloatArray,
    xy: FloatArray,
    ball: int,
    *,
    in_image: bool,
) -> None:
    """Log the path of a ball up to each frame, from its points (n, 2) m at t (n,) s."""
    shown = shot.clip.t
    now = shot.fit.trajectory.at(shown).xy[:, ball]
    there = np.flatnonzero(np.isfinite(now[:, 0]) & (shown > t[0]))
    lines = [np.vstack([xy[t < shown[k]], now[k]]) for k in there]
    if in_image:
        camera, radius = shot.scene.camera, shot.scene.table.ball_radius
        lines = [camera.to_pixels(line, radius, k) for k, line in zip(shot.clip.frames[there], lines, strict=True)]
    colour = (shot.frame_colours if in_image else shot.plan_colours)[ball]
    look = {"colors": colour, "radii": rr.Radius.ui_points(1.5)}
    stream.log(entity, rr.LineStrips2D.from_fields(**look), static=True)
    if len(there):
        strips = rr.LineStrips2D.columns(strips=[line.astype(np.float32) for line in lines])
        stream.send_columns(entity, build_time_columns(shown[there], shot.clip), strips)


def _frame_time_columns(clip: Clip, count: int) -> list[rr.TimeColumn]:
    """Return the time columns of the first `count` frames."""
    return build_time_columns(clip.t[:count], clip)
