"""A shot prepared for a recording: results of the chain, sampled motion and colours."""

from __future__ import annotations

import errno
import os
import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.trajectory import State
from models.core.typing import ByteArray, FloatArray
from pipeline.reporting.figures.motion_samples import find_moving_balls, simplify_line
from video.drawing.palette import INK, adapt_to_any_background, ensure_contrast
from video.io.clip import Clip

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
