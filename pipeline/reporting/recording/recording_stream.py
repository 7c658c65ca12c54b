"""Streams of the rerun SDK: identity, timelines, and closing with error reporting."""

from __future__ import annotations

import errno
import os
import uuid
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from models.core.typing import FloatArray

VIDEO_TIME = "video_time"
"""Name of the timeline in s of the source clip."""
FRAME = "frame"
"""Name of the timeline of the frame index; a time between two frames belongs to the frame that is shown."""


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


def build_time_columns(t: FloatArray, shown: FloatArray) -> list[rr.TimeColumn]:
    """Build both time columns for times t (K,) s of a clip with frames at `shown` (T,) s."""
    return [
        rr.TimeColumn(VIDEO_TIME, duration=np.asarray(t, dtype=np.float64)),
        rr.TimeColumn(FRAME, sequence=frame_shown_at(t, shown)),
    ]


def frame_shown_at(t: FloatArray, shown: FloatArray) -> NDArray[np.int64]:
    """Return the frame (K,) shown at t (K,) s; before the first frame, the first."""
    return np.maximum(np.searchsorted(shown, np.asarray(t) + 1e-9, side="right") - 1, 0).astype(np.int64)
