"""Forecast fans in a recording, beside the observed motion."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.estimation.forecast.forecast_values import ForecastFan, ForecastFans
from pipeline.reporting.figures.motion_samples import simplify_line
from pipeline.reporting.recording.recorded_shot import RecordedShot, build_time_columns
from video.drawing.palette import mix_colours

MIN_DRAWN_TRAVEL_RADII = 1.0
"""Least travel of a drawn ensemble member, ball radii."""
MAX_DRAWN_MEMBERS = 24
"""Largest number of drawn ensemble members of a fan."""
DARKENING = 0.35
"""Share of black in their colours."""


def log_forecast_fans(stream: rr.RecordingStream, shot: RecordedShot, forecasts: ForecastFans) -> None:
    """Log `picture/fan/BALL` and `plan/fan/BALL`: predicted paths, shown until the next fan or their end.

    Args:
        stream: Recording.
        shot: Shot of the recording.
        forecasts: Fans of predicted paths at several times.
    """
    ends = [*(fan.t for fan in forecasts.fans[1:]), float(shot.clip.t[-1])]
    for fan, following in zip(forecasts.fans, ends, strict=False):  # there may be no fan
        _log_fan(stream, shot, fan, min(float(fan.times[-1]), following))


def _log_fan(stream: rr.RecordingStream, shot: RecordedShot, fan: ForecastFan, until: float) -> None:
    radius = shot.scene.table.ball_radius
    shown = shot.clip.t
    frames = np.flatnonzero((shown >= fan.t - 1e-9) & (shown < until))
    if not len(frames):
        return
    for k, ball in enumerate(fan.ids):
        lines = [
            line
            for line in fan.members[:MAX_DRAWN_MEMBERS, :, k]
            if _travels_farther(line, MIN_DRAWN_TRAVEL_RADII * radius)
        ]
        if not lines or ball not in shot.ids:
            continue
        paths = [path[simplify_line(path, 0.2 * radius)] for path in map(_drop_missing, lines)]
        _log_bundles(stream, shot, f"plan/fan/{ball}", [paths], frames[:1], until)
        pixels = [_to_pixels(shot, paths, int(frame)) for frame in _select_redraw_frames(shot, frames)]
        _log_bundles(stream, shot, f"picture/fan/{ball}", pixels, _select_redraw_frames(shot, frames), until)
        for view, colours in (("plan", shot.plan_colours), ("picture", shot.frame_colours)):
            red, green, blue = (int(part) for part in colours[shot.ids.index(ball)])
            colour = mix_colours((red, green, blue), (0, 0, 0), DARKENING)
            faint = {"colors": colour, "radii": rr.Radius.ui_points(0.4)}
            stream.log(f"{view}/fan/{ball}", rr.LineStrips2D.from_fields(**faint), static=True)


def _log_bundles(
    stream: rr.RecordingStream,
    shot: RecordedShot,
    entity: str,
    bundles: list[list[FloatArray]],
    frames: NDArray[np.intp],
    until: float,
) -> None:
    """Log one bundle of paths for each of these frames, and an empty one at `until` (s)."""
    strips = [path.astype(np.float32) for bundle in bundles for path in bundle]
    counts = [len(bundle) for bundle in bundles]
    t = np.append(shot.clip.t[frames], until)
    columns = rr.LineStrips2D.columns(strips=strips).partition([*counts, 0])
    stream.send_columns(entity, build_time_columns(t, shot.clip.t), columns)


def _select_redraw_frames(shot: RecordedShot, frames: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the frames at which a fan is drawn again: all if the camera moves, otherwise the first."""
    return frames if shot.scene.camera.motion is not None else frames[:1]


def _to_pixels(shot: RecordedShot, paths: list[FloatArray], frame: int) -> list[FloatArray]:
    """Project paths (n, 2) m into a frame."""
    return [shot.scene.camera.to_pixels(path, shot.scene.table.ball_radius, frame) for path in paths]


def _drop_missing(line: FloatArray) -> FloatArray:
    """Return the finite points of a path."""
    return line[np.isfinite(line[:, 0])]


def _travels_farther(line: FloatArray, least: float) -> bool:
    """Return whether a path (n, 2) leaves its first point by more than `least` (m)."""
    positions = _drop_missing(line)
    return len(positions) > 1 and float(np.linalg.norm(positions - positions[0], axis=1).max()) > least
