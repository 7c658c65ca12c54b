"""Events in a recording: a mark from the event on, a caption with time, speed and gap, and a log line."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.events import Events
from pipeline.reporting.recording.recorded_shot import RecordedShot
from pipeline.reporting.recording.recording_stream import FRAME, VIDEO_TIME, build_time_columns, frame_shown_at
from pipeline.reporting.text.text_formatting import format_event, format_event_time, is_undecided

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
