"""Layers of the table from above, in m; y runs down, as in the picture."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.scene import Table
from models.core.typing import FloatArray
from pipeline.reporting.recording.frame_layer import log_past
from pipeline.reporting.recording.recorded_shot import Shot
from pipeline.reporting.recording.recording_stream import timeline

POCKET_RADII = 1.6
"""Ball radii of a drawn pocket."""
ARROW_RADII = 1.0
"""Ball radii that a usual residual is drawn long."""
ABOVE = 50.0
"""Order in which arrows are drawn: over the balls that they begin in."""


def log_table(stream: rr.RecordingStream, table: Table) -> None:
    """Noses and pockets."""
    outline = np.vstack([table.corners, table.corners[:1]])
    stream.log("plan/table", rr.LineStrips2D([outline], colors=[120, 160, 140], radii=0.006), static=True)
    if len(table.pocket_centres):
        holes = rr.Points2D(table.pocket_centres, radii=POCKET_RADII * table.ball_radius, colors=[60, 60, 60])
        stream.log("plan/pockets", holes, static=True)


def log_balls(stream: rr.RecordingStream, shot: Shot) -> None:
    """Where the fit has each ball, as large as it is."""
    places = shot.fit.trajectory.at(shot.clip.t).xy
    for k, ball in enumerate(shot.ids):
        there = np.isfinite(places[:, k, 0])
        if there.any():
            points = rr.Points2D.columns(positions=places[there, k]).partition(there.astype(np.int64))
            stream.send_columns(f"plan/balls/{ball}", timeline(shot.clip.t, shot.clip.t), points)
        look = {"colors": shot.lines[k], "radii": shot.scene.table.ball_radius, "labels": [ball], "show_labels": False}
        stream.log(f"plan/balls/{ball}", rr.Points2D.from_fields(**look), static=True)


def log_ways(stream: rr.RecordingStream, shot: Shot) -> None:
    """The whole fitted path of each ball that moves, faint; over it what lies before now, bright."""
    for k in np.flatnonzero(shot.moves):
        t, xy = shot.way(int(k))
        faint = {"colors": [*shot.plotted[k], 90], "radii": rr.Radius.ui_points(0.75)}
        stream.log(f"plan/paths/{shot.ids[k]}", rr.LineStrips2D([xy], **faint), static=True)
        log_past(stream, f"plan/past/{shot.ids[k]}", shot, t, xy, int(k), in_picture=False)


def log_residuals(stream: rr.RecordingStream, shot: Shot) -> None:
    """Arrows from where the fit has a moving ball towards where it was measured, `magnification` times as long."""
    tracks, fit = shot.tracks, shot.fit
    factor = magnification(shot)
    fitted = fit.trajectory.at(tracks.t).xy
    for k in np.flatnonzero(shot.moves):
        seen = np.isfinite(fit.residual[:, k, 0]) & np.isfinite(fitted[:, k, 0]) & fit.moving[:, k]
        entity = f"plan/residuals/{shot.ids[k]}"
        if not seen.any():
            continue
        arrows = rr.Arrows2D.columns(origins=fitted[seen, k], vectors=factor * fit.residual[seen, k])
        stream.send_columns(entity, timeline(tracks.t, shot.clip.t), arrows.partition(seen.astype(np.int64)))
        look = {"colors": [255, 96, 160], "radii": rr.Radius.ui_points(1.0), "draw_order": ABOVE}
        stream.log(entity, rr.Arrows2D.from_fields(**look), static=True)


def magnification(shot: Shot) -> float:
    """1, 2 or 5 times a power of ten by which residuals are drawn longer than they are; at least 1."""
    usual = _usual(np.linalg.norm(shot.fit.residual[shot.fit.moving], axis=-1))
    if not usual > 0:
        return 1.0
    wanted = max(ARROW_RADII * shot.scene.table.ball_radius / usual, 1.0)
    step = 10.0 ** np.floor(np.log10(wanted))
    return float(step * max(n for n in (1, 2, 5) if n * step <= wanted * (1 + 1e-12)))


def _usual(sizes: FloatArray) -> float:
    known = sizes[np.isfinite(sizes)]
    return float(np.median(known)) if len(known) else 0.0
