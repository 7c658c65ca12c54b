"""A stream of the rerun SDK: its name, its timelines, and its end."""

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
"""s of the source clip."""
FRAME = "frame"
"""Pictures of the source clip; what lies between two stands at the one that is shown."""


def open_stream(digest: str, title: str) -> rr.RecordingStream:
    """A recording of the clip with this SHA-256, under its own time alone.

    The same clip always has the same names, so that layers written apart come together in the viewer; every clip has
    an application of its own, so that each of several keeps the blueprint that fits its picture.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    stream = rr.RecordingStream(f"trueroll-{digest[:12]}", recording_id=uuid.uuid5(uuid.NAMESPACE_OID, digest))
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    stream.send_recording_name(title)
    return stream


def finish(stream: rr.RecordingStream, path: Path) -> None:
    """Write what is still in memory; rerun writes behind our back, and tells of a failure only now."""
    try:
        stream.flush()
    except RuntimeError as error:
        raise OSError(errno.EIO, f"rerun cannot write its recording ({error}); is the disk full?", str(path)) from error
    finally:
        stream.disconnect()


def timeline(t: FloatArray, shown: FloatArray) -> list[rr.TimeColumn]:
    """Moments t (K,) s on both timelines, of a clip that shows its pictures at `shown` (F,) s."""
    return [
        rr.TimeColumn(VIDEO_TIME, duration=np.asarray(t, dtype=np.float64)),
        rr.TimeColumn(FRAME, sequence=frame_at(t, shown)),
    ]


def frame_at(t: FloatArray, shown: FloatArray) -> NDArray[np.int64]:
    """The picture (K,) that is on the screen at t (K,) s; the first before anything is."""
    return np.maximum(np.searchsorted(shown, np.asarray(t) + 1e-9, side="right") - 1, 0).astype(np.int64)
