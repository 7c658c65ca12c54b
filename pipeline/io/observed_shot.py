"""Tracks and scene of one shot of a run folder, a track folder or a tracks.csv, as input of a fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.scene import Camera, Scene, Table
from models.core.tracks import KINDS, Tracks
from pipeline.io.run_folder import DEFAULT_SIGMA, parse_camera, parse_table, read_scene_document
from pipeline.io.saved_shot import has_shot, read_shot
from pipeline.io.text_table import Columns, build_row_grid, read_text_table, require_tracks_file
from pipeline.io.track_conventions import TrackRows, interpret_tracks
from pipeline.io.track_folder import parse_scene_entry, require_positions_on_table

# Cloth colour (CIE L*a*b*) of a table without a video.
DEFAULT_CLOTH_LAB = np.array([40.0, -30.0, 10.0])
# m above the cloth, height of the assumed camera if the folder has no calibration.
ASSUMED_CAMERA_HEIGHT = 4.0
# px, width of the image of the assumed camera.
ASSUMED_IMAGE_WIDTH = 1000


def read_observed_shot(source: Path, shot: int | None = None) -> tuple[Tracks, Scene, int]:
    """Read tracks and scene of one shot: from a saved shot, else from tables without the rows that physics filled in.

    Args:
        source: A run folder, a track folder or its tracks.csv.
        shot: Number of the shot; None for the first.

    Returns:
        Tracks of T frames and N balls, scene, and number of the shot.

    Raises:
        OptionError: The source is no shot of billiards, or cannot be read.
    """
    if has_shot(source) and not shot:
        saved = read_shot(source)
        return saved.tracks, saved.scene, 0
    path = require_tracks_file(source)
    if not (path.parent / "scene.json").is_file():
        raise OptionError(
            f"{path} has no scene.json beside it, which must describe the table; only billiards can be predicted"
        )
    document = read_scene_document(path.parent / "scene.json")
    rows, columns = _read_rows(path, document)
    number = _select_shot(rows, shot, path)
    table = parse_table(document)
    if rows.is_usable.any():
        require_positions_on_table(rows.positions[rows.is_usable], (table.length, table.width), path)
    lab = document["table"].get("cloth_lab")
    cloth = np.array(lab, float) if isinstance(lab, list) and len(lab) == 3 else DEFAULT_CLOTH_LAB
    scene = Scene(table, parse_camera(document) or _build_overhead_camera(document, table), cloth, rows.notes)
    return _build_tracks(rows, columns, number, scene, path), scene, number


def list_shot_numbers(source: Path) -> list[int]:
    """List the numbers of the shots of a run folder, a track folder or its tracks.csv.

    Args:
        source: As in `read_observed_shot`.

    Returns:
        The numbers, ascending.

    Raises:
        OptionError: There is no such table, or it cannot be read.
    """
    path = require_tracks_file(source)
    rows, _ = _read_rows(path, read_scene_document(path.parent / "scene.json"))
    return sorted(set(rows.shot[rows.is_usable].tolist()))


def _read_rows(path: Path, document: dict[str, Any]) -> tuple[TrackRows, Columns]:
    """Read the rows of a table of tracks beside a scene.json, and its columns."""
    table = read_text_table(path)
    table.require(("x", "y"))
    return interpret_tracks(
        table, parse_scene_entry(document, path.parent / "scene.json").describe_tracks()
    ), table.columns


def _select_shot(rows: TrackRows, shot: int | None, path: Path) -> int:
    numbers = sorted(set(rows.shot.tolist()))
    if not numbers:
        raise OptionError(f"{path} has no rows")
    chosen: int = numbers[0] if shot is None else shot
    if chosen not in numbers:
        raise OptionError(f"{path} has the shots {', '.join(map(str, numbers))}; shot {chosen} is not among them")
    return chosen


def _build_tracks(rows: TrackRows, columns: Columns, number: int, scene: Scene, path: Path) -> Tracks:
    """Arrange rows as T frames by N balls."""
    here = np.flatnonzero(rows.is_usable & (rows.shot == number))
    if not len(here):
        raise OptionError(f"{path} has no observed position of a ball")
    names, grid = rows.ids[here], build_row_grid(rows.frame[here], rows.ids[here])
    ids, first = grid.bodies, here[grid.first]
    blank = np.full(len(rows.t), np.nan)
    xy = grid.scatter(rows.positions[here])
    sigma = rows.unit * grid.scatter(columns.get("sigma", blank)[here])
    sigma = np.where(np.isfinite(xy[..., 0]) & ~(sigma > 0), DEFAULT_SIGMA, sigma)
    labels = dict(zip(names.tolist(), columns.get("kind", rows.ids)[here].tolist(), strict=True))
    kinds = [labels[name].split("-")[0] for name in ids]  # without a column kind, names such as `red-2`
    radius = scene.table.ball_radius
    filled = np.where(np.isfinite(xy), xy, [scene.table.length / 2, scene.table.width / 2])
    computed = np.where(np.isfinite(xy), scene.camera.to_pixels(filled, radius), np.nan)
    px = grid.scatter(np.stack([columns.get("x_px", blank), columns.get("y_px", blank)], axis=1)[here])
    size = grid.scatter(columns.get("radius_px", blank)[here])
    return Tracks(
        rows.frame[first], rows.t[first], ids, tuple(kind if kind in KINDS else "ball" for kind in kinds), xy,
        np.where(np.isfinite(px), px, computed), sigma, sigma,
        np.zeros_like(xy), np.where(np.isfinite(size), size, scene.camera.radius_px(filled, radius)),
        np.tile([70.0, 0.0, 0.0], (len(ids), 1)),
    )  # fmt: skip


def _build_overhead_camera(document: dict[str, Any], table: Table) -> Camera:
    """Build a camera straight above the table; without `image` in scene.json, the table fills the image."""
    stated = document.get("image")
    image = stated if isinstance(stated, dict) else {}
    scale = float(image.get("px_per_m") or ASSUMED_IMAGE_WIDTH / table.length)
    left, top = (float(value) for value in image.get("origin_px") or (0.0, 0.0))
    wide, tall = (int(image.get(name) or scale * side) for name, side in
                  (("width_px", table.length), ("height_px", table.width)))  # fmt: skip
    # A pinhole camera above the origin; positions on the cloth have the scale of scene.json.
    matrix = np.array(
        [
            [scale, 0.0, -left / ASSUMED_CAMERA_HEIGHT, left],
            [0.0, scale, -top / ASSUMED_CAMERA_HEIGHT, top],
            [0.0, 0.0, -1.0 / ASSUMED_CAMERA_HEIGHT, 1.0],
        ]
    )
    corners = scale * table.corners + [left, top]
    return Camera(matrix, wide, tall, corners, 0.01 * np.eye(8), "cloth", ASSUMED_CAMERA_HEIGHT, 0.3)
