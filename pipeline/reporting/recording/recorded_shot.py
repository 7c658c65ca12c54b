"""A shot prepared for a recording: stream, layout of the viewer, sampled motion and colours, and layers over the clip.

The layers are in px of the upright frames of the clip.
"""

from __future__ import annotations

import errno
import os
import uuid
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.encodings import TextLogColumn

from models.core.detections import Detections
from models.core.fit_result import Fit
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.trajectory import State
from models.core.typing import ByteArray, FloatArray
from pipeline.reporting.figures.motion_samples import find_moving_balls, simplify_line
from video.drawing.palette import INK, adapt_to_any_background, ensure_contrast
from video.io.clip import Clip
from video.io.video_writer import ensure_playable, re_encode_clip

# Name of the timeline in s of the source clip.
VIDEO_TIME = "video_time"
# Name of the timeline of the frame index; a time between two frames belongs to the frame that is shown.
FRAME = "frame"


def open_stream(digest: str, title: str) -> rr.RecordingStream:
    """Open the recording of the clip with this SHA-256, without rerun's own timelines.

    The identifiers depend on the clip alone, so that the viewer merges layers from several files. Every clip is a
    separate application, so that it keeps its own blueprint.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    stream = rr.RecordingStream(f"trueroll-{digest[:12]}", recording_id=uuid.uuid5(uuid.NAMESPACE_OID, digest))
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    stream.send_recording_name(title)
    return stream


def finish_stream(stream: rr.RecordingStream, path: Path) -> None:
    """Flush and close a recording.

    Args:
        stream: Recording.
        path: Its file, for the error message.

    Raises:
        OSError: The file could not be written; rerun writes in the background and reports a failure only here.
    """
    try:
        stream.flush()
    except RuntimeError as error:
        raise OSError(errno.EIO, f"rerun cannot write its recording ({error}); is the disk full?", str(path)) from error
    finally:
        stream.disconnect()


def build_time_columns(t: FloatArray, clip: Clip) -> list[rr.TimeColumn]:
    """Build both time columns for times t (K,) s of a clip."""
    return [
        rr.TimeColumn(VIDEO_TIME, duration=np.asarray(t, dtype=np.float64)),
        rr.TimeColumn(FRAME, sequence=clip.frames_shown_at(t)),
    ]


# Samples per second of the fitted paths and plots.
PATH_HZ = 100.0
# Largest distance of a drawn line from the path, ball radii: invisible, and few points keep the recording small.
PATH_TOLERANCE_RADII = 0.05


@dataclass(frozen=True, slots=True)
class RecordedShot:
    """Results of a clip with N balls, prepared for the layers of a recording."""

    clip: Clip
    scene: Scene
    tracks: Tracks
    fit: Fit
    t: FloatArray
    """(K,) s, over the motion."""
    state: State
    """State of all balls at t."""
    is_moving: NDArray[np.bool_]
    """(N,) whether each ball leaves its initial position."""
    frame_colours: ByteArray
    """(N, 3) RGB of the balls on the frames."""
    plan_colours: ByteArray
    """(N, 3) RGB of the balls on the background of the viewer, which is dark or light."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Names of the balls."""
        return self.fit.trajectory.ids

    def path_points(self, ball: int) -> tuple[FloatArray, FloatArray]:
        """Return times (n,) s and positions (n, 2) m of the simplified path of a ball."""
        there = np.isfinite(self.state.xy[:, ball, 0])
        t, xy = self.t[there], self.state.xy[there, ball]
        indices = simplify_line(xy, PATH_TOLERANCE_RADII * self.scene.table.ball_radius)
        return t[indices], xy[indices]

    def to_frame_pixels(self, xy: FloatArray) -> NDArray[np.float32]:
        """Project positions (n, 2) m to px: (T, n, 2) for every frame if the camera moves, otherwise (1, n, 2)."""
        radius, camera = self.scene.table.ball_radius, self.scene.camera
        if camera.motion is None:
            return camera.to_pixels(xy, radius)[None].astype(np.float32)
        return np.array([camera.to_pixels(xy, radius, k) for k in self.clip.frames], dtype=np.float32)


def build_recorded_shot(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit) -> RecordedShot:
    """Prepare the results of a clip for the layers of a recording."""
    colours = [look.colour for look in tracks.looks]
    lines = np.array([ensure_contrast(colour, INK) for colour in colours], dtype=np.uint8).reshape(-1, 3)
    plotted = np.array([adapt_to_any_background(colour) for colour in colours], dtype=np.uint8).reshape(-1, 3)
    t = fit.trajectory.sample_times(PATH_HZ)
    state = fit.trajectory.at(t)
    return RecordedShot(
        clip, scene, tracks, fit, t, state, find_moving_balls(state.xy, scene.table.ball_radius), lines, plotted
    )


# Margin of the plan around the table, ball radii.
MARGIN_RADII = 4.0


def arrange_panels(views: rrb.Container, timeline: str = VIDEO_TIME) -> rrb.Blueprint:
    """Arrange the viewer around views: one timeline, played again and again, and no other panel."""
    time = rrb.TimePanel(timeline=timeline, state="collapsed", play_state="playing", loop_mode="all")
    return rrb.Blueprint(views, time, rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"))


def build_blueprint(clip: Clip, table: Table | None) -> rrb.Blueprint:
    """Build the layout for a clip; without a table, the plan has no fixed bounds."""
    whole = rrb.VisualBounds2D(x_range=[-0.5, clip.width - 0.5], y_range=[-0.5, clip.height - 0.5])
    return arrange_panels(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="picture", name="Video", visual_bounds=whole),
                rrb.Vertical(build_plan_view(table), _build_text_views(), row_shares=[3, 2]),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(
                _build_plot_view(clip, "speed", "Speed (m/s)"),
                _build_plot_view(clip, "energy", "Energy (mJ)"),
                _build_plot_view(clip, "residual", "Measured minus fitted (mm)"),
            ),
            row_shares=[5, 2],
        ),
    )


def build_plan_view(table: Table | None) -> rrb.Spatial2DView:
    """Build the view of the table from above."""
    if table is None:
        return rrb.Spatial2DView(origin="plan", name="Plan (m)")
    margin = MARGIN_RADII * table.ball_radius
    below = table.width + 1.5 * margin  # with room for the caption
    bounds = rrb.VisualBounds2D(x_range=[-margin, table.length + margin], y_range=[-margin, below])
    return rrb.Spatial2DView(origin="plan", name="Plan (m)", visual_bounds=bounds)


def _build_text_views() -> rrb.Tabs:
    body, level = TextLogColumn("Body"), TextLogColumn("LogLevel")
    events = rrb.TextLogView(
        origin="log/events", name="Events", columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=[body])
    )
    chain = rrb.TextLogView(
        origin="log/chain",
        name="Processing log",
        columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=[level, body]),
    )
    return rrb.Tabs(events, rrb.TextDocumentView(origin="about", name="Fitted model"), chain, active_tab=0)


def _build_plot_view(clip: Clip, what: str, name: str) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)  # the upper right is empty: balls are fast at the beginning
    first, last = (rrb.TimeRangeBoundary.absolute(seconds=float(clip.t[k])) for k in (0, -1))
    whole = rrb.TimeAxis(
        view_range=rrb.TimeRange(start=first, end=last)
    )  # same range in all plots, so that times align
    return rrb.TimeSeriesView(origin=f"plots/{what}", name=name, plot_legend=legend, axis_x=whole)


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
    """Log the whole fitted path of each moving ball, faint, and its path up to each frame, bright, in both views."""
    for k in map(int, np.flatnonzero(shot.is_moving)):
        t, xy = shot.path_points(k)
        for view, colours in (("picture", shot.frame_colours), ("plan", shot.plan_colours)):
            entity = f"{view}/paths/{shot.ids[k]}"
            lines = shot.to_frame_pixels(xy) if view == "picture" else xy[None].astype(np.float32)
            times = build_time_columns(shot.clip.t[: len(lines)], shot.clip)
            stream.send_columns(entity, times, rr.LineStrips2D.columns(strips=list(lines)))
            faint = {"colors": [*colours[k], 90], "radii": rr.Radius.ui_points(0.75)}
            stream.log(entity, rr.LineStrips2D.from_fields(**faint), static=True)
            _log_path_so_far(stream, f"{view}/past/{shot.ids[k]}", shot, t, xy, k, colours[k])


def _log_path_so_far(
    stream: rr.RecordingStream,
    entity: str,
    shot: RecordedShot,
    t: FloatArray,
    xy: FloatArray,
    ball: int,
    colour: ByteArray,
) -> None:
    """Log the path of a ball up to each frame, from its points (n, 2) m at t (n,) s."""
    shown = shot.clip.t
    now = shot.fit.trajectory.at(shown).xy[:, ball]
    there = np.flatnonzero(np.isfinite(now[:, 0]) & (shown > t[0]))
    lines = [np.vstack([xy[t < shown[k]], now[k]]) for k in there]
    if entity.startswith("picture"):
        camera, radius = shot.scene.camera, shot.scene.table.ball_radius
        lines = [camera.to_pixels(line, radius, k) for k, line in zip(shot.clip.frames[there], lines, strict=True)]
    look = {"colors": colour, "radii": rr.Radius.ui_points(1.5)}
    stream.log(entity, rr.LineStrips2D.from_fields(**look), static=True)
    if len(there):
        strips = rr.LineStrips2D.columns(strips=[line.astype(np.float32) for line in lines])
        stream.send_columns(entity, build_time_columns(shown[there], shot.clip), strips)
