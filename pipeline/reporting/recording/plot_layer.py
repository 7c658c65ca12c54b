"""Plots over time in a recording: speed, energy and residual, one line per moving ball."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.typing import FloatArray
from pipeline.reporting.figures.motion_samples import kinetic_energy
from pipeline.reporting.recording.recorded_shot import RecordedShot
from pipeline.reporting.recording.recording_stream import build_time_columns

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
