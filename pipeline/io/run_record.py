"""Reading of what answers about contacts need of a run folder: observations, events and fitted motion of a shot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from models.core.ball_look import describe_unseen_balls
from models.core.errors import OptionError
from models.core.events import EVENT_KINDS, Events
from models.core.naming import build_naming
from models.core.typing import FloatArray
from models.estimation.contact_test.contact_moment import ClothPriors
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record
from models.estimation.reconstruction.close_passes import list_close_passes
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.io.explanation_json import parse_explanation
from pipeline.io.run_folder import (
    DEFAULT_SIGMA,
    Columns,
    parse_camera,
    parse_table,
    read_csv_columns,
    read_scene_document,
)
from pipeline.io.shot_folder import has_shot, read_shot

GRID_HZ = 1000.0


def read_shot_record(folder: Path, shot: int = 0, cloth: ClothPriors | None = None) -> ShotRecord:
    """Read one shot of a run folder: its saved shot, or the tables of a folder that holds none.

    Args:
        folder: Run folder.
        shot: Number of the shot.
        cloth: What is known about the friction of the cloth, with which close passes are tested again; None for what
            the shot was explained with.

    Returns:
        Observations and fitted motion of the N balls.

    Raises:
        OptionError: The folder is missing or incomplete, or `cloth` is given and it holds no saved shot.
    """
    if not folder.is_dir():
        raise OptionError(f"A run folder was expected; {folder} is none. Run the clip first: trueroll run CLIP")
    if has_shot(folder) or cloth is not None:
        return _record_saved_shot(folder, shot, cloth)
    scene = read_scene_document(folder / "scene.json")
    tracks, events, motion = (
        _select_shot_rows(read_csv_columns(folder / f"{name}.csv", wanted), shot)
        for name, wanted in (
            ("tracks", ("frame", "t", "id", "x", "y")),
            ("events", ("kind", "t", "a", "b")),
            ("trajectory", ("t", "id", "x", "y", "vx", "vy")),
        )
    )
    if not len(tracks["t"]) or not len(motion["t"]):
        raise OptionError(f"{folder} has no motion of shot {shot}")
    table = parse_table(scene)
    ids = tuple(dict.fromkeys(tracks["id"].tolist()))
    kinds = dict(zip(tracks["id"].tolist(), tracks.get("kind", tracks["id"]).tolist(), strict=True))
    observed = tracks.get("observed", np.ones(len(tracks["t"]))) > 0
    ball = np.array([ids.index(name) for name in tracks["id"]])
    order = np.lexsort((tracks["t"], ball))
    order = order[observed[order]]
    sigma = np.nan_to_num(tracks.get("sigma", np.full(len(observed), DEFAULT_SIGMA)), nan=DEFAULT_SIGMA)
    blank = np.full(len(observed), np.nan)
    frame, at = np.unique(tracks["frame"], return_index=True)
    parsed, camera, own_kinds = _parse_events(events), parse_camera(scene), tuple(kinds[name] for name in ids)
    naming = build_naming(table, camera, ids, describe_unseen_balls(ids, own_kinds))
    return ShotRecord(
        ids, own_kinds, frame.astype(np.int64), tracks["t"][at],
        ball[order], tracks["t"][order], np.stack([tracks["x"], tracks["y"]], axis=1)[order],
        np.stack([tracks.get("x_px", blank), tracks.get("y_px", blank)], axis=1)[order],
        np.maximum(sigma, 1e-6)[order], parsed, *_resample_motion(motion, ids, table.ball_radius), table,
        camera, parse_explanation(scene, parsed), naming,
    )  # fmt: skip


def _record_saved_shot(folder: Path, number: int, cloth: ClothPriors | None) -> ShotRecord:
    """Record the saved shot of a run folder."""
    shot = read_shot(folder)
    if cloth is not None:
        shot = replace(shot, passes=list_close_passes(shot, cloth))
    fit = view_shot(shot)
    if number or not len(fit.trajectory.start):
        raise OptionError(f"{folder} has no motion of shot {number}")
    scene = shot.scene
    return make_shot_record(shot.tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)


def _select_shot_rows(columns: Columns, shot: int) -> Columns:
    if "shot" not in columns:
        return columns
    rows = columns["shot"] == shot
    return {name: values[rows] for name, values in columns.items()}


def _parse_events(columns: Columns) -> Events:
    rows = np.argsort(columns["t"], kind="stable")
    rows = rows[[columns["kind"][k] in EVENT_KINDS for k in rows]] if len(rows) else rows
    t = columns["t"][rows]

    def number(name: str, scale: float = 1.0) -> FloatArray:
        return np.asarray(scale * columns[name][rows] if name in columns else np.full(len(t), np.nan), np.float64)

    text = {name: tuple(str(v) for v in columns[name][rows]) for name in ("kind", "a", "b")}
    return Events(
        text["kind"], t, np.nan_to_num(number("t_sigma"), nan=1e-3), number("frame"), text["a"], text["b"],
        np.stack([number("x"), number("y")], axis=1), np.nan_to_num(number("probability"), nan=1.0),
        number("gap_mm", 1e-3), number("gap_mm_sigma", 1e-3), number("speed"),
    )  # fmt: skip


def _resample_motion(
    motion: Columns, ids: tuple[str, ...], radius: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Resample the motion on one regular grid.

    Returns times (M,), positions, velocities and contact-point velocities (M, N, 2), and sigmas (M, N); NaN where a
    ball has no motion.
    """
    first, last = float(motion["t"].min()), float(motion["t"].max())
    t = first + np.arange(round((last - first) * GRID_HZ) + 1) / GRID_HZ
    blank = np.full(len(motion["t"]), np.nan)
    spin_x, spin_y = (motion.get(name, blank) for name in ("wx", "wy"))
    columns = np.stack(
        [motion["x"], motion["y"], motion["vx"], motion["vy"], motion["vx"] - radius * spin_y,
         motion["vy"] + radius * spin_x, motion.get("sigma", np.full(len(blank), DEFAULT_SIGMA))], axis=1,
    )  # fmt: skip
    grid = np.full((len(t), len(ids), columns.shape[1]), np.nan)
    for k, name in enumerate(ids):
        rows = np.flatnonzero(motion["id"] == name)
        rows = rows[np.argsort(motion["t"][rows], kind="stable")]
        if len(rows):
            own = motion["t"][rows]
            inside = (t >= own[0] - 1e-9) & (t <= own[-1] + 1e-9)
            grid[inside, k] = np.stack([np.interp(t[inside], own, column[rows]) for column in columns.T], axis=1)
    return t, grid[..., 0:2], grid[..., 2:4], grid[..., 4:6], grid[..., 6]
