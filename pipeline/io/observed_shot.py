"""One shot of a run folder, a track folder or a tracks.csv, as the tracks and the scene that a fit works on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.core.errors import OptionError
from models.core.scene import Camera, Scene, Table
from models.core.tracks import KINDS, Tracks
from models.core.typing import FloatArray
from pipeline.io.run_folder import USUAL_SIGMA, Columns, camera_of, read_scene, read_table, table_of

CLOTH_LAB = np.array([40.0, -30.0, 10.0])
"""Of a table that no picture shows."""
HEIGHT = 4.0
"""m above the cloth at which the camera is put where nothing says how the table was seen."""
WIDE = 1000
"""px of its picture."""


def read_seen_shot(source: Path, shot: int | None = None) -> tuple[Tracks, Scene, int]:
    """Tracks, scene and number of one shot, the first where none is asked for; `source` is a folder or its tracks.csv.

    Only what was seen is kept. OptionError, one sentence, where this is no shot of billiards.
    """
    path = source / "tracks.csv" if source.is_dir() else source
    if not path.is_file():
        raise OptionError(f"A run's folder, a track folder or its tracks.csv was expected; there is no {path}")
    if not (path.parent / "scene.json").is_file():
        raise OptionError(
            f"{path} stands alone: a scene.json beside it must say what moves; only billiards can be predicted"
        )
    told = read_scene(path.parent / "scene.json")
    columns = read_table(path, ("id", "x", "y"))
    columns, number = _one_shot(columns, shot, path)
    table = table_of(told)
    scene = Scene(table, camera_of(told) or _above(told, table), _cloth(told), ())
    return _tracks(columns, told, scene, path), scene, number


def _one_shot(columns: Columns, shot: int | None, path: Path) -> tuple[Columns, int]:
    numbers = np.nan_to_num(columns.get("shot", np.zeros(len(columns["id"])))).astype(np.int64)
    there = sorted(set(numbers.tolist()))
    if not there:
        raise OptionError(f"{path} holds no rows")
    chosen = there[0] if shot is None else shot
    if chosen not in there:
        raise OptionError(f"{path} holds the shots {', '.join(map(str, there))}; shot {chosen} is not among them")
    rows = numbers == chosen
    return {name: values[rows] for name, values in columns.items()}, chosen


def _tracks(columns: Columns, told: dict[str, Any], scene: Scene, path: Path) -> Tracks:
    """Rows as T pictures by N balls; of a ball that is there twice in a picture, the first row counts."""
    frame, t = _clock(columns, told, path)
    seen = np.isfinite(columns["x"]) & np.isfinite(columns["y"]) & np.isfinite(t)
    seen &= columns.get("observed", np.ones(len(t))) > 0
    if not seen.any():
        raise OptionError(f"{path} holds no place of a ball that was seen")
    frames, first, row = np.unique(frame[seen], return_index=True, return_inverse=True)
    shown = t[seen][first]
    if np.any(np.diff(shown) <= 0):
        raise OptionError(f"{path}: t must grow with frame, and does not")
    ids = tuple(dict.fromkeys(columns["id"][seen].tolist()))
    ball = np.array([ids.index(name) for name in columns["id"][seen]])
    grid = _Grid(row[::-1], ball[::-1], (len(frames), len(ids)))
    metres = _metres(told, path)
    xy = metres * grid.of(np.stack([columns["x"], columns["y"]], axis=1)[seen])
    sigma = metres * grid.of(columns.get("sigma", np.full(len(t), np.nan))[seen])
    sigma = np.where(np.isfinite(xy[..., 0]) & ~(sigma > 0), USUAL_SIGMA, sigma)
    radius = scene.table.ball_radius
    somewhere = np.where(np.isfinite(xy), xy, [scene.table.length / 2, scene.table.width / 2])
    computed = np.where(np.isfinite(xy), scene.camera.to_pixels(somewhere, radius), np.nan)
    blank = np.full(len(t), np.nan)
    px = grid.of(np.stack([columns.get("x_px", blank), columns.get("y_px", blank)], axis=1)[seen])
    size = grid.of(columns.get("radius_px", blank)[seen])
    return Tracks(
        frames, shown, ids, _kinds(columns, seen, ids), xy, np.where(np.isfinite(px), px, computed), sigma, sigma,
        np.zeros_like(xy), np.where(np.isfinite(size), size, scene.camera.radius_px(somewhere, radius)),
        np.tile([70.0, 0.0, 0.0], (len(ids), 1)),
    )  # fmt: skip


class _Grid:
    """Rows of a table put where they belong among pictures and balls."""

    def __init__(self, row: NDArray[np.intp], ball: NDArray[np.intp], shape: tuple[int, int]) -> None:
        self._row, self._ball, self._shape = row, ball, shape

    def of(self, values: FloatArray) -> FloatArray:
        """(T, N, ...) from values (K, ...), NaN elsewhere."""
        grid = np.full((*self._shape, *values.shape[1:]), np.nan)
        grid[self._row, self._ball] = values[::-1]
        return grid


def _clock(columns: Columns, told: dict[str, Any], path: Path) -> tuple[NDArray[np.int64], FloatArray]:
    """Frame and time of every row; either may stand for the other where the rate is known."""
    fps = told.get("fps")
    rate = float(fps) if isinstance(fps, int | float) and fps > 0 else None
    if "frame" in columns and np.isfinite(columns["frame"]).all():
        frame = columns["frame"].astype(np.int64)
    elif "t" in columns:
        frame = np.unique(columns["t"], return_inverse=True)[1].astype(np.int64)
    else:
        raise OptionError(f"{path} says no time: it needs the column t, or frame with fps in scene.json")
    if "t" in columns:
        return frame, np.asarray(columns["t"], np.float64)
    if rate is None:
        raise OptionError(f"{path} says no time: it needs the column t, or fps in scene.json")
    return frame, frame / rate


def _metres(told: dict[str, Any], path: Path) -> float:
    """Metres of a unit of x and y."""
    if told.get("units", "m") == "m":
        return 1.0
    scale = told.get("px_per_m") or (told.get("image") or {}).get("px_per_m")
    if told["units"] != "px" or not isinstance(scale, int | float) or scale <= 0:
        raise OptionError(f"{path}: places are in m, or in px with px_per_m in scene.json; got {told['units']!r}")
    return 1 / float(scale)


def _kinds(columns: Columns, seen: NDArray[np.bool_], ids: tuple[str, ...]) -> tuple[str, ...]:
    """As the file says, else as the name does (`red-2`)."""
    told = columns["kind"][seen] if "kind" in columns else columns["id"][seen]
    named = dict(zip(columns["id"][seen].tolist(), told.tolist(), strict=True))
    kinds = (named[name].split("-")[0] for name in ids)
    return tuple(kind if kind in KINDS else "ball" for kind in kinds)


def _above(told: dict[str, Any], table: Table) -> Camera:
    """A camera straight above; where `image` does not say how the table lies in the picture, it fills it."""
    image = told.get("image") if isinstance(told.get("image"), dict) else {}
    image = image or {}
    scale = float(image.get("px_per_m") or WIDE / table.length)
    left, top = (float(value) for value in image.get("origin_px") or (0.0, 0.0))
    wide, tall = (int(image.get(name) or scale * side) for name, side in
                  (("width_px", table.length), ("height_px", table.width)))  # fmt: skip
    # a pinhole at HEIGHT above the origin, so that what lies on the cloth has the scale that was told
    matrix = np.array(
        [[scale, 0.0, -left / HEIGHT, left], [0.0, scale, -top / HEIGHT, top], [0.0, 0.0, -1.0 / HEIGHT, 1.0]]
    )
    corners = scale * table.corners + [left, top]
    return Camera(matrix, wide, tall, corners, 0.01 * np.eye(8), "cloth", HEIGHT, 0.3)


def _cloth(told: dict[str, Any]) -> FloatArray:
    lab = told["table"].get("cloth_lab")
    return np.array(lab, float) if isinstance(lab, list) and len(lab) == 3 else CLOTH_LAB
