"""Contacts as marked instants: a mark from the moment on, time, speed and gap told for a while, and the log."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.events import Events
from pipeline.reporting.recording.recorded_shot import Shot
from pipeline.reporting.recording.recording_stream import FRAME, VIDEO_TIME, frame_at, timeline
from pipeline.reporting.text.sentences import event_sentence, event_time

TOLD_FOR = 0.8
"""s for which the words stand below the plan."""
CAPTION_RADII = 3.0
"""Ball radii below the table at which they stand."""
MARK = (255, 200, 40)


def log_events(stream: rr.RecordingStream, shot: Shot) -> None:
    """`log/events`, and a mark for each event but rests in `picture/events` and `plan/events`."""
    events = shot.fit.events
    if len(events):
        words = [f"{event_time(events, k)}: {event_sentence(events, k)}" for k in range(len(events))]
        told = rr.TextLog.columns(text=words, level=["INFO"] * len(words))
        stream.send_columns("log/events", timeline(events.t, shot.clip.t), told)
    marked = [k for k in range(len(events)) if events.kind[k] != "rest"]
    for k in marked:
        _log_mark(stream, shot, k)
    if marked:
        _log_captions(stream, shot, marked)


def mark_text(events: Events, k: int) -> str:
    """Who, when, how fast, and by how much the free paths overlap, as far as it is known."""
    parts = [event_time(events, k), event_sentence(events, k)]
    if np.isfinite(events.gap[k]):
        parts.append(f"gap {1000 * events.gap[k]:+.1f} mm")
    return " · ".join(parts)


def _log_mark(stream: rr.RecordingStream, shot: Shot, k: int) -> None:
    """A mark stands from the event on; in a picture that drifts it goes with the table."""
    events, shown = shot.fit.events, shot.clip.t
    for view in ("plan", "picture"):
        entity = f"{view}/events/{k:02d}-{events.kind[k]}"
        look = {"colors": MARK, "radii": rr.Radius.ui_points(4), "labels": [mark_text(events, k)], "show_labels": False}
        stream.log(entity, rr.Points2D.from_fields(**look), static=True)
        drifts = view == "picture" and shot.scene.camera.motion is not None
        t = np.concatenate([events.t[[k]], shown[shown > events.t[k]] if drifts else np.empty(0)])
        at = np.repeat(events.xy[[k]], len(t), axis=0)
        if view == "picture":
            at = shot.scene.camera.to_pixels(at, shot.scene.table.ball_radius, frame_at(t, shown))
        stream.send_columns(entity, timeline(t, shown), rr.Points2D.columns(positions=at))


def _log_captions(stream: rr.RecordingStream, shot: Shot, marked: list[int]) -> None:
    """Below the plan, where nothing hides it: what just happened."""
    events, last = shot.fit.events, float(shot.clip.t[-1])
    table = shot.scene.table
    place = rr.Points2D([[table.length / 2, table.width + CAPTION_RADII * table.ball_radius]], radii=0.0, colors=MARK)
    for k, following in zip(marked, [*events.t[marked[1:]], np.inf], strict=True):
        stream.set_time(VIDEO_TIME, duration=float(events.t[k]))
        stream.set_time(FRAME, sequence=int(frame_at(events.t[[k]], shot.clip.t)[0]))
        stream.log("plan/caption", place, rr.Points2D.from_fields(labels=[mark_text(events, k)], show_labels=True))
        end = min(float(events.t[k]) + TOLD_FOR, last)
        if end < following:
            stream.set_time(VIDEO_TIME, duration=end)
            stream.set_time(FRAME, sequence=int(frame_at(np.array([end]), shot.clip.t)[0]))
            stream.log("plan/caption", rr.Clear(recursive=False))
    stream.reset_time()
