"""The recording of a run for the rerun viewer: picture, plan, plots and events on one timeline."""

from __future__ import annotations

import errno
import os
import uuid
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from models.detections import Detections
from models.fit import Fit
from models.scene import Scene
from models.tracks import Tracks
from pipeline.publish import aside
from pipeline.sampling import ever_moves, sample_motion
from pipeline.sentences import event_sentence, event_time
from video.clip import Clip
from video.embed import playable
from video.motion_marks import spaced
from video.palette import INK, apart_from, ball_colour, legible

Floats = NDArray[np.float64]
Colours = NDArray[np.uint8]

VIDEO_TIME = "video_time"
FRAME = "frame"
PATH_HZ = 100.0
"""Samples per second of the fitted paths and plots."""
CLOTH_MARGIN_RADII = 4.0


def write_recording(
    clip: Clip, scene: Scene, detections: Detections, tracks: Tracks, fit: Fit, path: Path, title: str
) -> None:
    """Write `path` (.rrd), named `title`, with a blueprint; timelines are seconds of the source clip and its frames.

    Entities: `picture/` in px (video, detections, tracks, paths, events), `plan/` in m (table, balls, paths,
    events), `plots/` (speed m/s, residual mm), `log/events` and `about`.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    recording = rr.RecordingStream("trueroll", recording_id=uuid.uuid5(uuid.NAMESPACE_OID, clip.digest))
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    with aside(path) as fresh:
        recording.save(fresh, default_blueprint=_blueprint(clip, scene))
        recording.send_recording_name(title)
        _log_video(recording, clip, path)
        _log_detections(recording, clip, detections)
        _log_motion(recording, clip, scene, tracks, fit)
        _log_events(recording, clip, scene, fit)
        recording.log("about", rr.TextDocument(_about(scene, fit), media_type=rr.MediaType.MARKDOWN), static=True)
        _finish(recording, path)


def _finish(recording: rr.RecordingStream, path: Path) -> None:
    """Write what is still in memory; rerun writes behind our back, and tells of a failure only now."""
    try:
        recording.flush()
    except RuntimeError as error:
        raise OSError(errno.EIO, f"rerun cannot write its recording ({error}); is the disk full?", str(path)) from error
    finally:
        recording.disconnect()


def _log_motion(recording: rr.RecordingStream, clip: Clip, scene: Scene, tracks: Tracks, fit: Fit) -> None:
    """Everything that has a ball's colour."""
    seen = [ball_colour(*ball) for ball in zip(tracks.kinds, tracks.colour, strict=True)]
    names = np.array([legible(colour) for colour in seen], dtype=np.uint8)
    colours = np.array([apart_from(colour, INK) for colour in seen], dtype=np.uint8)
    _log_tracks(recording, tracks, names)
    _log_paths(recording, clip, scene, fit, colours)
    _log_plan(recording, clip, scene, fit, colours)
    _log_plots(recording, scene, tracks, fit, colours)


def _timeline(t: Floats, frame: NDArray[np.integer] | None = None) -> list[rr.TimeColumn]:
    columns = [rr.TimeColumn(VIDEO_TIME, duration=np.asarray(t, dtype=np.float64))]
    if frame is not None:
        columns.append(rr.TimeColumn(FRAME, sequence=frame))
    return columns


def _log_video(recording: rr.RecordingStream, clip: Clip, beside: Path) -> None:
    """The clip, or a copy that the viewer plays; the recording holds its bytes."""
    with TemporaryDirectory(prefix=".", dir=beside.parent) as folder:
        asset = rr.AssetVideo(path=playable(clip, Path(folder) / "copy.mp4"))
    recording.log("picture/video", asset, static=True)
    stamps = np.sort(asset.read_frame_timestamps_nanos())[: clip.frame_count]
    shown = np.arange(len(stamps))
    recording.send_columns(
        "picture/video",
        _timeline(clip.t[shown], shown),
        rr.VideoFrameReference.columns_nanos(stamps),
    )


def _log_detections(recording: rr.RecordingStream, clip: Clip, detections: Detections) -> None:
    frames, counts = np.unique(detections.frame, return_counts=True)
    if len(frames):
        points = rr.Points2D.columns(positions=detections.centre, radii=np.maximum(detections.sigma, 0.3))
        recording.send_columns("picture/detections", _timeline(clip.t[frames], frames), points.partition(counts))
    recording.log("picture/detections", rr.Points2D.from_fields(colors=[255, 255, 255, 160]), static=True)


def _log_tracks(recording: rr.RecordingStream, tracks: Tracks, colours: Colours) -> None:
    """A ring the size of the ball where it was seen."""
    seen = tracks.observed
    angle = np.linspace(0, 2 * np.pi, 33)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for k, ball in enumerate(tracks.ids):
        rows = np.flatnonzero(seen[:, k])
        rings = tracks.px[rows, k, None, :] + 1.15 * tracks.radius_px[rows, k, None, None] * circle
        strips = rr.LineStrips2D.columns(strips=list(rings.astype(np.float32)))
        entity = f"picture/tracks/{ball}"
        if len(rows):
            times = _timeline(tracks.t, tracks.frame)
            recording.send_columns(entity, times, strips.partition(seen[:, k].astype(np.int64)))
        recording.log(
            entity,
            rr.LineStrips2D.from_fields(colors=colours[k], radii=rr.Radius.ui_points(1.0), labels=[ball]),
            static=True,
        )


def _log_paths(recording: rr.RecordingStream, clip: Clip, scene: Scene, fit: Fit, colours: Colours) -> None:
    _, xy, _ = sample_motion(fit.trajectory, PATH_HZ)
    moves = ever_moves(xy, scene.table.ball_radius)
    for k, ball in enumerate(fit.trajectory.ids):
        there = np.isfinite(xy[:, k, 0])
        if not moves[k]:
            continue
        look = {"colors": colours[k], "radii": rr.Radius.ui_points(1.0)}
        recording.log(f"plan/paths/{ball}", rr.LineStrips2D([xy[there, k]], **look), static=True)
        px = _in_pictures(clip, scene, xy[there, k])
        strips = rr.LineStrips2D.columns(strips=list(px[:, spaced(px[0], np.zeros(px.shape[1], dtype=bool))]))
        recording.send_columns(f"picture/paths/{ball}", _first_times(clip, len(px)), strips)
        recording.log(f"picture/paths/{ball}", rr.LineStrips2D.from_fields(**look), static=True)


def _in_pictures(clip: Clip, scene: Scene, xy: Floats) -> NDArray[np.float32]:
    """Places (n, 2) m in px: (F, n, 2) of every picture where the camera drifts, (1, n, 2) of all where it stands."""
    radius, motion = scene.table.ball_radius, scene.camera.motion
    if motion is None:
        return scene.camera.to_pixels(xy, radius)[None].astype(np.float32)
    pictures = (scene.camera.to_pixels(xy, radius, frame) for frame in range(clip.frame_count))
    return np.array(list(pictures), dtype=np.float32)


def _first_times(clip: Clip, count: int) -> list[rr.TimeColumn]:
    """The times of the first `count` pictures."""
    return _timeline(clip.t[:count], np.arange(count))


def _log_plan(recording: rr.RecordingStream, clip: Clip, scene: Scene, fit: Fit, colours: Colours) -> None:
    table = scene.table
    outline = np.vstack([table.corners, table.corners[:1]])
    recording.log("plan/table", rr.LineStrips2D([outline], colors=[120, 160, 140], radii=0.006), static=True)
    if len(table.pocket_centres):
        holes = rr.Points2D(table.pocket_centres, radii=1.6 * table.ball_radius, colors=[60, 60, 60])
        recording.log("plan/pockets", holes, static=True)
    places = fit.trajectory.at(clip.t).xy
    frames = np.arange(clip.frame_count)
    for k, ball in enumerate(fit.trajectory.ids):
        there = np.isfinite(places[:, k, 0])
        if there.any():
            points = rr.Points2D.columns(positions=places[there, k]).partition(there.astype(np.int64))
            recording.send_columns(f"plan/balls/{ball}", _timeline(clip.t, frames), points)
        look = rr.Points2D.from_fields(colors=colours[k], radii=table.ball_radius, labels=[ball], show_labels=False)
        recording.log(f"plan/balls/{ball}", look, static=True)


def _log_plots(recording: rr.RecordingStream, scene: Scene, tracks: Tracks, fit: Fit, colours: Colours) -> None:
    t, xy, speed = sample_motion(fit.trajectory, PATH_HZ)
    moves = ever_moves(xy, scene.table.ball_radius)
    error = 1000 * np.linalg.norm(fit.residual, axis=-1)
    for k, ball in enumerate(fit.trajectory.ids):
        if not moves[k]:
            continue
        line = rr.SeriesLines(colors=colours[k], names=ball, widths=1.5)
        there = np.isfinite(speed[:, k])
        recording.log(f"plots/speed/{ball}", line, static=True)
        recording.send_columns(f"plots/speed/{ball}", _timeline(t[there]), rr.Scalars.columns(scalars=speed[there, k]))
        seen = np.isfinite(error[:, k]) & fit.moving[:, k]
        recording.log(f"plots/residual/{ball}", line, static=True)
        if seen.any():
            residuals = rr.Scalars.columns(scalars=error[seen, k])
            recording.send_columns(f"plots/residual/{ball}", _timeline(tracks.t[seen], tracks.frame[seen]), residuals)


def _log_events(recording: rr.RecordingStream, clip: Clip, scene: Scene, fit: Fit) -> None:
    events = fit.events
    frames = np.arange(clip.frame_count)
    for k in range(len(events)):
        recording.set_time(VIDEO_TIME, duration=float(events.t[k]))
        recording.set_time(FRAME, sequence=int(np.searchsorted(clip.t[frames], events.t[k])))
        recording.log(
            "log/events",
            rr.TextLog(f"{event_time(events, k)}: {event_sentence(events, k)}", level=rr.TextLogLevel.INFO),
        )
    recording.reset_time()
    marked = [k for k in range(len(events)) if events.kind[k] != "rest"]
    if not marked:
        return
    labels = [f"{events.kind[k]} {events.t[k]:.3f} s" for k in marked]
    look = {"radii": rr.Radius.ui_points(4), "colors": [255, 200, 40], "labels": labels, "show_labels": False}
    recording.log("plan/events", rr.Points2D(events.xy[marked], **look), static=True)
    px = _in_pictures(clip, scene, events.xy[marked])
    points = rr.Points2D.columns(positions=px.reshape(-1, 2)).partition(np.full(len(px), len(marked)))
    recording.send_columns("picture/events", _first_times(clip, len(px)), points)
    recording.log("picture/events", rr.Points2D.from_fields(**look), static=True)


def _about(scene: Scene, fit: Fit) -> str:
    lines = [f"# Trust: {fit.trust.light}", *(f"- {reason}" for reason in fit.trust.reasons), "", "## Fitted"]
    lines += ["| parameter | value | sigma | unit |", "|---|---|---|---|"]
    for p in fit.parameters:
        lines.append(f"| {p.name} | {p.value:.4g} | {p.sigma:.2g}{' (prior)' if p.prior_only else ''} | {p.unit} |")
    lines += ["", f"Noise {1000 * fit.noise:.2f} mm, chi2 per degree of freedom {fit.chi2_per_dof:.2f}", "", "## Table"]
    lines += [f"- {note}" for note in scene.notes]
    return "\n".join(lines)


def _blueprint(clip: Clip, scene: Scene) -> rrb.Blueprint:
    margin = CLOTH_MARGIN_RADII * scene.table.ball_radius
    whole = rrb.VisualBounds2D(x_range=[-0.5, clip.width - 0.5], y_range=[-0.5, clip.height - 0.5])
    plan = rrb.VisualBounds2D(
        x_range=[-margin, scene.table.length + margin], y_range=[-margin, scene.table.width + margin]
    )
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)  # most is fast and uncertain at the beginning
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(origin="picture", name="Picture", visual_bounds=whole),
                rrb.Spatial2DView(origin="plan", name="Plan (m)", visual_bounds=plan),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="plots/speed", name="Speed (m/s)", plot_legend=legend),
                rrb.TimeSeriesView(origin="plots/residual", name="Measured minus fitted (mm)", plot_legend=legend),
                rrb.TextLogView(origin="log", name="Events"),
                rrb.TextDocumentView(origin="about", name="What was fitted"),
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=VIDEO_TIME, state="collapsed", play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
