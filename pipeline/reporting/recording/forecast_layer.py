"""What was foretold at a few moments, beside what came."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.estimation.forecast.forecast_values import Foresight, Foresights
from pipeline.reporting.figures.motion_samples import few_points
from pipeline.reporting.recording.recorded_shot import Shot
from pipeline.reporting.recording.recording_stream import timeline
from video.drawing.palette import mix

WAY = 1.0
"""Ball radii that a course goes at least, to be drawn."""
DRAWN = 24
"""Courses of a fan that are drawn."""
FAINT = 0.35
"""Share of black in their colour."""


def log_fans(stream: rr.RecordingStream, shot: Shot, foresights: Foresights) -> None:
    """`picture/fan/BALL` and `plan/fan/BALL`: courses from each moment on, until the next fan or their end."""
    ends = [*(fan.t for fan in foresights.fans[1:]), float(shot.clip.t[-1])]
    for fan, following in zip(foresights.fans, ends, strict=False):  # there may be no fan
        _log_fan(stream, shot, fan, min(float(fan.times[-1]), following))


def _log_fan(stream: rr.RecordingStream, shot: Shot, fan: Foresight, until: float) -> None:
    radius = shot.scene.table.ball_radius
    shown = shot.clip.t
    frames = np.flatnonzero((shown >= fan.t - 1e-9) & (shown < until))
    if not len(frames):
        return
    for k, ball in enumerate(fan.ids):
        lines = [line for line in fan.courses[:DRAWN, :, k] if _goes(line, WAY * radius)]
        if not lines or ball not in shot.ids:
            continue
        ways = [known[few_points(known, 0.2 * radius)] for known in map(_known, lines)]
        _log_ways(stream, shot, f"plan/fan/{ball}", [ways], frames[:1], until)
        pixels = [_to_pixels(shot, ways, int(frame)) for frame in _told(shot, frames)]
        _log_ways(stream, shot, f"picture/fan/{ball}", pixels, _told(shot, frames), until)
        for view, colours in (("plan", shot.plotted), ("picture", shot.lines)):
            red, green, blue = (int(part) for part in colours[shot.ids.index(ball)])
            colour = mix((red, green, blue), (0, 0, 0), FAINT)
            faint = {"colors": colour, "radii": rr.Radius.ui_points(0.4)}
            stream.log(f"{view}/fan/{ball}", rr.LineStrips2D.from_fields(**faint), static=True)


def _log_ways(
    stream: rr.RecordingStream,
    shot: Shot,
    entity: str,
    bundles: list[list[FloatArray]],
    frames: NDArray[np.intp],
    until: float,
) -> None:
    """Bundles of ways, one for each of these pictures; then nothing."""
    strips = [way.astype(np.float32) for bundle in bundles for way in bundle]
    counts = [len(bundle) for bundle in bundles]
    t = np.append(shot.clip.t[frames], until)
    columns = rr.LineStrips2D.columns(strips=strips).partition([*counts, 0])
    stream.send_columns(entity, timeline(t, shot.clip.t), columns)


def _told(shot: Shot, frames: NDArray[np.intp]) -> NDArray[np.intp]:
    """The pictures at which a fan is drawn anew: all where the camera drifts."""
    return frames if shot.scene.camera.motion is not None else frames[:1]


def _to_pixels(shot: Shot, ways: list[FloatArray], frame: int) -> list[FloatArray]:
    return [shot.scene.camera.to_pixels(way, shot.scene.table.ball_radius, frame) for way in ways]


def _known(line: FloatArray) -> FloatArray:
    return line[np.isfinite(line[:, 0])]


def _goes(line: FloatArray, least: float) -> bool:
    known = _known(line)
    return len(known) > 1 and float(np.linalg.norm(known - known[0], axis=1).max()) > least
