"""Layers that each stage of the chain adds to a recording, finished or live."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from models.core.detections import Detections
from models.core.events import Events
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from pipeline.reporting.figures.motion_samples import kinetic_energy
from pipeline.reporting.recording import text_layer
from pipeline.reporting.recording.frame_layer import log_detections, log_paths, log_tracks, log_video
from pipeline.reporting.recording.plan_layer import log_fitted_balls, log_plan_paths, log_residuals, log_table
from pipeline.reporting.recording.recorded_shot import RecordedShot
from pipeline.reporting.recording.recording_stream import FRAME, VIDEO_TIME, build_time_columns, frame_shown_at
from pipeline.reporting.text.text_formatting import format_event, format_event_time, is_undecided
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


CAPTION_SECONDS = 0.8
"""s for which a caption is shown below the plan."""
CAPTION_OFFSET_RADII = 3.0
"""Distance of captions from the table, ball radii."""
MARK_COLOUR = (255, 200, 40)


def log_events(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log all events in `log/events`, and a mark for each event except rests in `picture/events` and `plan/events`."""
    events = shot.fit.events
    if len(events):
        words = [f"{format_event_time(events, k)}: {format_event(events, k)}" for k in range(len(events))]
        columns = rr.TextLog.columns(text=words, level=["INFO"] * len(words))
        stream.send_columns("log/events", build_time_columns(events.t, shot.clip.t), columns)
    marked = [k for k in range(len(events)) if events.kind[k] != "rest"]
    for k in marked:
        _log_mark(stream, shot, k)
    if marked:
        _log_captions(stream, shot, marked)


def format_mark(events: Events, k: int) -> str:
    """Format time, sentence, the gap of the free paths if it is known, and the probability of an undecided event."""
    parts = [format_event_time(events, k), format_event(events, k)]
    if np.isfinite(events.gap[k]):
        parts.append(f"gap {1000 * events.gap[k]:+.1f} mm")
    if is_undecided(events.probability[k]):
        parts.append(f"undecided, {100 * events.probability[k]:.0f} %")
    return " · ".join(parts)


def _log_mark(stream: rr.RecordingStream, shot: RecordedShot, k: int) -> None:
    """Log a mark that is shown from the event on; if the camera moves, it follows the table."""
    events, shown = shot.fit.events, shot.clip.t
    for view in ("plan", "picture"):
        entity = f"{view}/events/{k:02d}-{events.kind[k]}"
        look = {
            "colors": MARK_COLOUR,
            "radii": rr.Radius.ui_points(4),
            "labels": [format_mark(events, k)],
            "show_labels": False,
        }
        stream.log(entity, rr.Points2D.from_fields(**look), static=True)
        drifts = view == "picture" and shot.scene.camera.motion is not None
        t = np.concatenate([events.t[[k]], shown[shown > events.t[k]] if drifts else np.empty(0)])
        at = np.repeat(events.xy[[k]], len(t), axis=0)
        if view == "picture":
            at = shot.scene.camera.to_pixels(at, shot.scene.table.ball_radius, frame_shown_at(t, shown))
        stream.send_columns(entity, build_time_columns(t, shown), rr.Points2D.columns(positions=at))


def _log_captions(stream: rr.RecordingStream, shot: RecordedShot, marked: list[int]) -> None:
    """Log captions of recent events below the plan."""
    events, last = shot.fit.events, float(shot.clip.t[-1])
    table = shot.scene.table
    place = rr.Points2D(
        [[table.length / 2, table.width + CAPTION_OFFSET_RADII * table.ball_radius]], radii=0.0, colors=MARK_COLOUR
    )
    for k, following in zip(marked, [*events.t[marked[1:]], np.inf], strict=True):
        stream.set_time(VIDEO_TIME, duration=float(events.t[k]))
        stream.set_time(FRAME, sequence=int(frame_shown_at(events.t[[k]], shot.clip.t)[0]))
        stream.log("plan/caption", place, rr.Points2D.from_fields(labels=[format_mark(events, k)], show_labels=True))
        end = min(float(events.t[k]) + CAPTION_SECONDS, last)
        if end < following:
            stream.set_time(VIDEO_TIME, duration=end)
            stream.set_time(FRAME, sequence=int(frame_shown_at(np.array([end]), shot.clip.t)[0]))
            stream.log("plan/caption", rr.Clear(recursive=False))
    stream.reset_time()


ALL_BALLS_COLOUR = (120, 170, 255)
"""Colour of the sum over all balls."""


def log_plots(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log `plots/speed` (m/s), `plots/energy` (mJ, also the sum of all balls) and `plots/residual` (mm)."""
    speed = np.linalg.norm(shot.state.v, axis=-1)
    energy = 1000 * kinetic_energy(shot.state, shot.scene.table)
    residual = 1000 * np.linalg.norm(shot.fit.residual, axis=-1)
    for k in np.flatnonzero(shot.is_moving):
        ball, colour = shot.ids[k], tuple(int(part) for part in shot.plan_colours[k])
        _log_line(stream, shot, f"plots/speed/{ball}", ball, colour, shot.t, speed[:, k])
        _log_line(stream, shot, f"plots/energy/{ball}", ball, colour, shot.t, energy[:, k])
        left = np.where(shot.fit.moving[:, k], residual[:, k], np.nan)
        _log_line(stream, shot, f"plots/residual/{ball}", ball, colour, shot.tracks.t, left)
    if shot.is_moving.sum() > 1:
        whole = np.nansum(energy[:, shot.is_moving], axis=1)
        _log_line(stream, shot, "plots/energy/all", "all balls", ALL_BALLS_COLOUR, shot.t, whole)


def _log_line(
    stream: rr.RecordingStream,
    shot: RecordedShot,
    entity: str,
    name: str,
    colour: tuple[int, ...],
    t: FloatArray,
    values: FloatArray,
) -> None:
    stream.log(entity, rr.SeriesLines(colors=colour, names=name, widths=1.5), static=True)
    finite = np.isfinite(values)
    if finite.any():
        stream.send_columns(
            entity, build_time_columns(t[finite], shot.clip.t), rr.Scalars.columns(scalars=values[finite])
        )
