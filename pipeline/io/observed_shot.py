"""Tracks and scene of one shot of a run folder, a track folder or a tracks.csv, as input of a fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.core.errors import OptionError
from models.core.scene import Camera, Scene, Table
from models.core.tracks import KINDS, Tracks
from models.core.typing import FloatArray
from pipeline.io.run_folder import (
    DEFAULT_SIGMA,
    Columns,
    parse_camera,
    parse_table,
    read_csv_columns,
    read_scene_document,
)
from pipeline.io.shot_folder import has_shot, read_shot

DEFAULT_CLOTH_LAB = np.array([40.0, -30.0, 10.0])
"""Cloth colour (CIE L*a*b*) of a table without a video."""
ASSUMED_CAMERA_HEIGHT = 4.0
"""m above the cloth, height of the assumed camera if the folder has no calibration."""
ASSUMED_IMAGE_WIDTH = 1000
"""px, width of the image of the assumed camera."""


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
    path = _find_track_table(source)
    if not (path.parent / "scene.json").is_file():
        raise OptionError(
            f"{path} has no scene.json beside it, which must describe the table; only billiards can be predicted"
        )
    document = read_scene_document(path.parent / "scene.json")
    columns = read_csv_columns(path, ("id", "x", "y"))
    columns, number = _select_shot(columns, shot, path)
    table = parse_table(document)
    scene = Scene(
        table, parse_camera(document) or _build_overhead_camera(document, table), _parse_cloth_colour(document), ()
    )
    return _build_tracks(columns, document, scene, path), scene, number


def list_shot_numbers(source: Path) -> list[int]:
    """List the numbers of the shots of a run folder, a track folder or its tracks.csv.

    Args:
        source: As in `read_observed_shot`.

    Returns:
        The numbers, ascending.

    Raises:
        OptionError: There is no such table, or it cannot be read.
    """
    columns = read_csv_columns(_find_track_table(source), ("id", "x", "y"))
    return _list_numbers(columns)


def _find_track_table(source: Path) -> Path:
    path = source / "tracks.csv" if source.is_dir() else source
    if not path.is_file():
        raise OptionError(f"A run's folder, a track folder or its tracks.csv was expected; there is no {path}")
    return path


def _list_numbers(columns: Columns) -> list[int]:
    numbers = np.nan_to_num(columns.get("shot", np.zeros(len(columns["id"])))).astype(np.int64)
    return sorted(set(numbers.tolist()))


def _select_shot(columns: Columns, shot: int | None, path: Path) -> tuple[Columns, int]:
    numbers = np.nan_to_num(columns.get("shot", np.zeros(len(columns["id"])))).astype(np.int64)
    numbers_present = _list_numbers(columns)
    if not numbers_present:
        raise OptionError(f"{path} has no rows")
    chosen = numbers_present[0] if shot is None else shot
    if chosen not in numbers_present:
        raise OptionError(
            f"{path} has the shots {', '.join(map(str, numbers_present))}; shot {chosen} is not among them"
        )
    rows = numbers == chosen
    return {name: values[rows] for name, values in columns.items()}, chosen


def _build_tracks(columns: Columns, document: dict[str, Any], scene: Scene, path: Path) -> Tracks:
    """Arrange rows as T frames by N balls; of several rows of a ball in a frame, the first counts."""
    frame, t = _parse_frames_and_times(columns, document, path)
    is_observed = np.isfinite(columns["x"]) & np.isfinite(columns["y"]) & np.isfinite(t)
    is_observed &= columns.get("observed", np.ones(len(t))) > 0
    if not is_observed.any():
        raise OptionError(f"{path} has no observed position of a ball")
    frames, first, row = np.unique(frame[is_observed], return_index=True, return_inverse=True)
    shown = t[is_observed][first]
    if np.any(np.diff(shown) <= 0):
        raise OptionError(f"{path}: t must increase with frame, but it does not")
    ids = tuple(dict.fromkeys(columns["id"][is_observed].tolist()))
    ball = np.array([ids.index(name) for name in columns["id"][is_observed]])
    grid = _TrackGrid(row[::-1], ball[::-1], (len(frames), len(ids)))
    metres = _metres_per_unit(document, path)
    xy = metres * grid.scatter(np.stack([columns["x"], columns["y"]], axis=1)[is_observed])
    sigma = metres * grid.scatter(columns.get("sigma", np.full(len(t), np.nan))[is_observed])
    sigma = np.where(np.isfinite(xy[..., 0]) & ~(sigma > 0), DEFAULT_SIGMA, sigma)
    radius = scene.table.ball_radius
    filled = np.where(np.isfinite(xy), xy, [scene.table.length / 2, scene.table.width / 2])
    computed = np.where(np.isfinite(xy), scene.camera.to_pixels(filled, radius), np.nan)
    blank = np.full(len(t), np.nan)
    px = grid.scatter(np.stack([columns.get("x_px", blank), columns.get("y_px", blank)], axis=1)[is_observed])
    size = grid.scatter(columns.get("radius_px", blank)[is_observed])
    return Tracks(
        frames, shown, ids, _parse_ball_classes(columns, is_observed, ids), xy,
        np.where(np.isfinite(px), px, computed), sigma, sigma,
        np.zeros_like(xy), np.where(np.isfinite(size), size, scene.camera.radius_px(filled, radius)),
        np.tile([70.0, 0.0, 0.0], (len(ids), 1)),
    )  # fmt: skip


class _TrackGrid:
    """Arrangement of K table rows as T frames by N balls."""

    def __init__(self, row: NDArray[np.intp], ball: NDArray[np.intp], shape: tuple[int, int]) -> None:
        self._row, self._ball, self._shape = row, ball, shape

    def scatter(self, values: FloatArray) -> FloatArray:
        """Arrange values (K, ...) as (T, N, ...), NaN elsewhere."""
        grid = np.full((*self._shape, *values.shape[1:]), np.nan)
        grid[self._row, self._ball] = values[::-1]
        return grid


def _parse_frames_and_times(
    columns: Columns, document: dict[str, Any], path: Path
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return frame and time (s) of every row; one follows from the other if the frame rate is known."""
    fps = document.get("fps")
    rate = float(fps) if isinstance(fps, int | float) and fps > 0 else None
    if "frame" in columns and np.isfinite(columns["frame"]).all():
        frame = columns["frame"].astype(np.int64)
    elif "t" in columns:
        frame = np.unique(columns["t"], return_inverse=True)[1].astype(np.int64)
    else:
        raise OptionError(f"{path} has no times: it needs the column t, or frame with fps in scene.json")
    if "t" in columns:
        return frame, np.asarray(columns["t"], np.float64)
    if rate is None:
        raise OptionError(f"{path} has no times: it needs the column t, or fps in scene.json")
    return frame, frame / rate


def _metres_per_unit(document: dict[str, Any], path: Path) -> float:
    """Return the length of a unit of x and y, m."""
    if document.get("units", "m") == "m":
        return 1.0
    scale = document.get("px_per_m") or (document.get("image") or {}).get("px_per_m")
    if document["units"] != "px" or not isinstance(scale, int | float) or scale <= 0:
        raise OptionError(
            f"{path}: positions must be in m, or in px with px_per_m in scene.json; got {document['units']!r}"
        )
    return 1 / float(scale)


def _parse_ball_classes(columns: Columns, is_observed: NDArray[np.bool_], ids: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ball classes from the column kind, otherwise from the names (`red-2`)."""
    labels = columns["kind"][is_observed] if "kind" in columns else columns["id"][is_observed]
    named = dict(zip(columns["id"][is_observed].tolist(), labels.tolist(), strict=True))
    kinds = (named[name].split("-")[0] for name in ids)
    return tuple(kind if kind in KINDS else "ball" for kind in kinds)


def _build_overhead_camera(document: dict[str, Any], table: Table) -> Camera:
    """Build a camera straight above the table; without `image` in scene.json, the table fills the image."""
    image = document.get("image") if isinstance(document.get("image"), dict) else {}
    image = image or {}
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


def _parse_cloth_colour(document: dict[str, Any]) -> FloatArray:
    lab = document["table"].get("cloth_lab")
    return np.array(lab, float) if isinstance(lab, list) and len(lab) == 3 else DEFAULT_CLOTH_LAB
