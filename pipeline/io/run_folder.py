"""The folder of a run read back, ours or anyone's: tracks, events, motion and scene, as contract and header say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from models.core.errors import OptionError
from models.core.events import EVENT_KINDS, Events
from models.core.scene import Camera, Table
from models.core.typing import FloatArray
from models.estimation.contact_test.shot_record import Record
from models.physics.billiards.tables import nearest_preset

Columns = dict[str, NDArray[Any]]

TEXT = ("id", "kind", "a", "b")
USUAL_SIGMA = 1e-3
"""m, of places whose error a folder does not state."""
GRID_HZ = 1000.0


def read_record(folder: Path, shot: int = 0) -> Record:
    """One shot of a run's folder; OptionError, one sentence, where it is not there or not whole."""
    if not folder.is_dir():
        raise OptionError(f"A run's folder was expected; {folder} is none. Run the clip first: trueroll run CLIP")
    scene = read_scene(folder / "scene.json")
    tracks, events, motion = (
        _shot(read_table(folder / f"{name}.csv", wanted), shot)
        for name, wanted in (
            ("tracks", ("frame", "t", "id", "x", "y")),
            ("events", ("kind", "t", "a", "b")),
            ("trajectory", ("t", "id", "x", "y", "vx", "vy")),
        )
    )
    if not len(tracks["t"]) or not len(motion["t"]):
        raise OptionError(f"{folder} holds no motion of shot {shot}")
    table = table_of(scene)
    ids = tuple(dict.fromkeys(tracks["id"].tolist()))
    kinds = dict(zip(tracks["id"].tolist(), tracks.get("kind", tracks["id"]).tolist(), strict=True))
    seen = tracks.get("observed", np.ones(len(tracks["t"]))) > 0
    ball = np.array([ids.index(name) for name in tracks["id"]])
    order = np.lexsort((tracks["t"], ball))
    order = order[seen[order]]
    sigma = np.nan_to_num(tracks.get("sigma", np.full(len(seen), USUAL_SIGMA)), nan=USUAL_SIGMA)
    blank = np.full(len(seen), np.nan)
    frame, at = np.unique(tracks["frame"], return_index=True)
    return Record(
        ids, tuple(kinds[name] for name in ids), frame.astype(np.int64), tracks["t"][at],
        ball[order], tracks["t"][order], np.stack([tracks["x"], tracks["y"]], axis=1)[order],
        np.stack([tracks.get("x_px", blank), tracks.get("y_px", blank)], axis=1)[order],
        np.maximum(sigma, 1e-6)[order], _events(events), *_grid(motion, ids, table.ball_radius), table,
        camera_of(scene),
    )  # fmt: skip


def read_scene(path: Path) -> dict[str, Any]:
    """scene.json; OptionError where there is none."""
    try:
        scene = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise OptionError(f"A run's folder holds {path.name}; {path}: {error.strerror}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise OptionError(f"{path} is no JSON: {error}") from error
    if not isinstance(scene, dict) or scene.get("scene") != "billiards":
        raise OptionError(f"{path} describes no billiards scene")
    return scene


def read_table(path: Path, wanted: tuple[str, ...]) -> Columns:
    """A csv as columns: text as text, numbers with NaN where a cell is empty."""
    text = {name: pa.string() for name in TEXT}
    try:
        table = csv.read_csv(path, convert_options=csv.ConvertOptions(column_types=text, strings_can_be_null=False))
    except (OSError, pa.ArrowException) as error:
        raise OptionError(f"A run's folder holds {path.name}; {path} cannot be read: {error}") from error
    if missing := [name for name in wanted if name not in table.column_names]:
        raise OptionError(f"{path} lacks the columns {', '.join(missing)}")
    columns: Columns = {}
    for name in table.column_names:
        values = table[name].to_pylist()
        try:
            columns[name] = np.array(values if name in TEXT else [np.nan if v is None else float(v) for v in values])
        except ValueError as error:
            raise OptionError(f"{path}: column {name} holds something that is no number: {error}") from error
    return columns


def table_of(scene: dict[str, Any]) -> Table:
    """The table of a scene.json; what it does not say is taken from the nearest table that is sold."""
    try:
        told = scene["table"]
        length, width = float(told["length"]), float(told["width"])
        sold = nearest_preset(length)
        radius = float(scene.get("ball_radius", sold.ball_radius))
        mass = float(scene.get("ball_mass", sold.ball_mass * (radius / sold.ball_radius) ** 3))
        pockets = bool(told.get("pockets", sold.pockets))
        return Table(told.get("name", f"{length:g}x{width:g}"), told.get("game", sold.game), length, width, radius,
                     mass, pockets)  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise OptionError(f"scene.json says no table of length and width in metres: {error}") from error


def camera_of(scene: dict[str, Any]) -> Camera | None:
    """The camera of a scene.json; None where it has none, or one that stands nowhere."""
    told, image = scene.get("calibration"), scene.get("image")
    if not isinstance(told, dict) or not isinstance(image, dict):
        return None
    try:
        camera = Camera(
            np.array(told["matrix"], float), int(image["width_px"]), int(image["height_px"]),
            np.array(told["corners_px"], float), np.array(told["corner_covariance_px2"], float),
            told["plane"], float(told["camera_height"]), float(told["camera_height_sigma"]),
        )  # fmt: skip
        return camera if np.linalg.matrix_rank(camera.matrix[:, :3]) == 3 else None
    except (KeyError, TypeError, ValueError) as error:
        raise OptionError(f"scene.json has a calibration that cannot be used: {error}") from error


def _shot(columns: Columns, shot: int) -> Columns:
    if "shot" not in columns:
        return columns
    rows = columns["shot"] == shot
    return {name: values[rows] for name, values in columns.items()}


def _events(columns: Columns) -> Events:
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


def _grid(
    motion: Columns, ids: tuple[str, ...], radius: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Moments (M,), places, velocities and slips (M, N, 2), sigmas (M, N) on one even grid; NaN where a ball is not."""
    first, last = float(motion["t"].min()), float(motion["t"].max())
    t = first + np.arange(round((last - first) * GRID_HZ) + 1) / GRID_HZ
    blank = np.full(len(motion["t"]), np.nan)
    spin_x, spin_y = (motion.get(name, blank) for name in ("wx", "wy"))
    columns = np.stack(
        [motion["x"], motion["y"], motion["vx"], motion["vy"], motion["vx"] - radius * spin_y,
         motion["vy"] + radius * spin_x, motion.get("sigma", np.full(len(blank), USUAL_SIGMA))], axis=1,
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
