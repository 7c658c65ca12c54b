"""Plots over time: speed, energy and what the fit leaves, a line per ball that moves."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.typing import FloatArray
from pipeline.reporting.figures.motion_samples import kinetic_energy
from pipeline.reporting.recording.recorded_shot import Shot
from pipeline.reporting.recording.recording_stream import timeline

TOGETHER = (120, 170, 255)
"""Colour of what belongs to all balls."""


def log_plots(stream: rr.RecordingStream, shot: Shot) -> None:
    """`plots/speed` m/s, `plots/energy` mJ (of all balls together too), `plots/residual` mm."""
    speed = np.linalg.norm(shot.state.v, axis=-1)
    energy = 1000 * kinetic_energy(shot.state, shot.scene.table)
    residual = 1000 * np.linalg.norm(shot.fit.residual, axis=-1)
    for k in np.flatnonzero(shot.moves):
        ball, colour = shot.ids[k], tuple(int(part) for part in shot.plotted[k])
        _log_line(stream, shot, f"plots/speed/{ball}", ball, colour, shot.t, speed[:, k])
        _log_line(stream, shot, f"plots/energy/{ball}", ball, colour, shot.t, energy[:, k])
        left = np.where(shot.fit.moving[:, k], residual[:, k], np.nan)
        _log_line(stream, shot, f"plots/residual/{ball}", ball, colour, shot.tracks.t, left)
    if shot.moves.sum() > 1:
        whole = np.nansum(energy[:, shot.moves], axis=1)
        _log_line(stream, shot, "plots/energy/all", "all balls", TOGETHER, shot.t, whole)


def _log_line(
    stream: rr.RecordingStream,
    shot: Shot,
    entity: str,
    name: str,
    colour: tuple[int, ...],
    t: FloatArray,
    values: FloatArray,
) -> None:
    stream.log(entity, rr.SeriesLines(colors=colour, names=name, widths=1.5), static=True)
    known = np.isfinite(values)
    if known.any():
        stream.send_columns(entity, timeline(t[known], shot.clip.t), rr.Scalars.columns(scalars=values[known]))
