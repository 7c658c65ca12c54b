"""Layers of the table seen from above in a recording, in m; y runs down, as in the image."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.scene import Table
from models.core.typing import FloatArray
from pipeline.reporting.recording.frame_layer import log_path_so_far
from pipeline.reporting.recording.recorded_shot import RecordedShot, build_time_columns

POCKET_RADII = 1.6
"""Radius of a drawn pocket, ball radii."""
ARROW_RADII = 1.0
"""Drawn length of the median residual, ball radii."""
ARROW_DRAW_ORDER = 50.0
"""Drawing order of arrows: above the balls."""


def log_table(stream: rr.RecordingStream, table: Table) -> None:
    """Log cushion noses and pockets."""
    outline = np.vstack([table.corners, table.corners[:1]])
    stream.log("plan/table", rr.LineStrips2D([outline], colors=[120, 160, 140], radii=0.006), static=True)
    if len(table.pocket_centres):
        holes = rr.Points2D(table.pocket_centres, radii=POCKET_RADII * table.ball_radius, colors=[60, 60, 60])
        stream.log("plan/pockets", holes, static=True)


def log_fitted_balls(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log the fitted position of each ball as a disc of its size."""
    places = shot.fit.trajectory.at(shot.clip.t).xy
    for k, ball in enumerate(shot.ids):
        there = np.isfinite(places[:, k, 0])
        if there.any():
            points = rr.Points2D.columns(positions=places[there, k]).partition(there.astype(np.int64))
            stream.send_columns(f"plan/balls/{ball}", build_time_columns(shot.clip.t, shot.clip.t), points)
        look = {
            "colors": shot.frame_colours[k],
            "radii": shot.scene.table.ball_radius,
            "labels": [shot.tracks.looks[k].name],
            "show_labels": False,
        }
        stream.log(f"plan/balls/{ball}", rr.Points2D.from_fields(**look), static=True)


def log_plan_paths(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log the whole fitted path of each moving ball, faint, and its path up to the current time, bright."""
    for k in np.flatnonzero(shot.is_moving):
        t, xy = shot.path_points(int(k))
        faint = {"colors": [*shot.plan_colours[k], 90], "radii": rr.Radius.ui_points(0.75)}
        stream.log(f"plan/paths/{shot.ids[k]}", rr.LineStrips2D([xy], **faint), static=True)
        log_path_so_far(stream, f"plan/past/{shot.ids[k]}", shot, t, xy, int(k), in_image=False)


def log_residuals(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log the residuals of moving balls as magnified arrows from the fitted to the measured position."""
    tracks, fit = shot.tracks, shot.fit
    factor = residual_magnification(shot)
    fitted = fit.trajectory.at(tracks.t).xy
    for k in np.flatnonzero(shot.is_moving):
        is_drawn = np.isfinite(fit.residual[:, k, 0]) & np.isfinite(fitted[:, k, 0]) & fit.moving[:, k]
        entity = f"plan/residuals/{shot.ids[k]}"
        if not is_drawn.any():
            continue
        arrows = rr.Arrows2D.columns(origins=fitted[is_drawn, k], vectors=factor * fit.residual[is_drawn, k])
        stream.send_columns(
            entity, build_time_columns(tracks.t, shot.clip.t), arrows.partition(is_drawn.astype(np.int64))
        )
        look = {"colors": [255, 96, 160], "radii": rr.Radius.ui_points(1.0), "draw_order": ARROW_DRAW_ORDER}
        stream.log(entity, rr.Arrows2D.from_fields(**look), static=True)


def residual_magnification(shot: RecordedShot) -> float:
    """Compute the magnification of drawn residuals: 1, 2 or 5 times a power of ten, at least 1."""
    usual = _finite_median(np.linalg.norm(shot.fit.residual[shot.fit.moving], axis=-1))
    if not usual > 0:
        return 1.0
    wanted = max(ARROW_RADII * shot.scene.table.ball_radius / usual, 1.0)
    step = 10.0 ** np.floor(np.log10(wanted))
    return float(step * max(n for n in (1, 2, 5) if n * step <= wanted * (1 + 1e-12)))


def _finite_median(sizes: FloatArray) -> float:
    """Compute the median of the finite values; 0 if there are none."""
    finite = sizes[np.isfinite(sizes)]
    return float(np.median(finite)) if len(finite) else 0.0
