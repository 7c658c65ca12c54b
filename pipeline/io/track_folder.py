"""A track folder: tracks.csv and scene.json of any scene, and run folders among them, as recordings for a diagnosis."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import Recording
from pipeline.io.track_folder_faults import off_the_table, refuse_what_is_missing

Size = Annotated[float, Field(gt=0, allow_inf_nan=False)]

NOISE_PX = 0.3
"""px: what a position is taken to be good for where nothing says it; the diagnosis measures it anyway."""
NOISE = 1e-3
"""m or rad, the same without a picture."""
_SAME = 0.05
"""by which two findings of the size of one table may differ."""
COLUMNS = {"billiards": ("x", "y"), "slide": ("x", "y"), "flight": ("x", "y", "z"), "pendulum": ("theta1", "theta2")}
"""What places are made of; of flight and pendulum what there is of it."""


class TableEntry(BaseModel):
    """The surface between the noses, m."""

    model_config = ConfigDict(extra="allow")
    length: Size
    width: Size


class ImageEntry(BaseModel):
    """How the scene lies in the picture."""

    model_config = ConfigDict(extra="allow")
    px_per_m: Size
    origin_px: tuple[float, float] = (0.0, 0.0)
    width_px: Size
    height_px: Size


class SceneEntry(BaseModel):
    """scene.json, as far as a diagnosis reads it."""

    model_config = ConfigDict(extra="allow")
    scene: Literal["billiards", "flight", "pendulum", "slide"] = "billiards"
    units: Literal["m", "px", "rad"] = "m"
    px_per_m: Size | None = None
    fps: Size | None = None
    table: TableEntry | None = None
    ball_radius: Size | None = None
    image: ImageEntry | None = None
    gravity: Size = 9.81
    model: list[str] | dict[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class TrackFolder:
    """What was seen, and of what."""

    entry: SceneEntry
    recordings: tuple[Recording, ...]
    coordinates: tuple[str, ...]
    """of a place, as the columns name them."""
    notes: tuple[str, ...] = ()
    """What is odd about the tracks, as sentences."""
    origins: Mapping[int, str] = field(default_factory=dict)
    """By shot: the name of its folder, where there are several, and its number there."""


def read_track_folders(folders: Sequence[Path]) -> TrackFolder:
    """All shots of all folders, numbered through; OptionError where they are not of one kind, or one comes twice."""
    places = [folder.resolve() for folder in folders]
    twice = next((folder for k, folder in enumerate(folders) if places[k] in places[:k]), None)
    if twice is not None:
        raise OptionError(f"{twice} was given twice; its shots would confirm themselves: name every folder once")
    read = [_read(folder) for folder in folders]
    first = read[0]
    for folder, other in zip(folders, read, strict=True):
        if (other.entry.scene, other.coordinates) != (first.entry.scene, first.coordinates):
            raise OptionError(
                f"{folder} holds {other.entry.scene}, {folders[0]} {first.entry.scene}; diagnose them apart"
            )
        if _elsewhere(first.entry, other.entry):
            raise OptionError(
                f"{folder} is of {_told(other.entry)}, {folders[0]} of {_told(first.entry)}; diagnose tables apart"
            )
    if len(read) == 1:
        return first
    shots = [
        (one, _called(one, folder, place))
        for folder, place in zip(read, places, strict=True)
        for one in folder.recordings
    ]
    numbered = tuple(replace(one, shot=number) for number, (one, _) in enumerate(shots))
    origins = {number: name for number, (_, name) in enumerate(shots)}
    notes = tuple(note for folder in read for note in folder.notes)
    return replace(first, recordings=numbered, notes=notes, origins=origins)


def _called(shot: Recording, folder: TrackFolder, place: Path) -> str:
    """A shot by its folder, and by its number there where it is not the only one."""
    return place.name if len(folder.recordings) == 1 else f"{place.name}, shot {shot.shot}"


def _elsewhere(one: SceneEntry, other: SceneEntry) -> bool:
    """Whether two folders are of different tables, as far as they say."""
    sizes = [(entry.table.length, entry.table.width) for entry in (one, other) if entry.table is not None]
    balls = [(entry.ball_radius,) for entry in (one, other) if entry.ball_radius is not None]
    return any(len(said) == 2 and not np.allclose(said[0], said[1], rtol=_SAME) for said in (sizes, balls))


def _told(entry: SceneEntry) -> str:
    """Of which table, in words."""
    size = f"a table of {entry.table.length:.3g} x {entry.table.width:.3g} m" if entry.table else "a table of no size"
    return f"{size} with balls of {2e3 * entry.ball_radius:.3g} mm" if entry.ball_radius else size


def _read(folder: Path) -> TrackFolder:
    refuse_what_is_missing(folder)
    entry = _entry(folder / "scene.json")
    path = folder / "tracks.csv"
    try:
        table = csv.read_csv(path)
    except OSError as error:
        raise OptionError(f"{path} cannot be read: {error}") from error
    except pa.ArrowInvalid as error:
        raise OptionError(f"{path} is not a table: {' '.join(str(error).split())}") from error
    names = tuple(name for name in COLUMNS[entry.scene] if name in table.column_names)
    fewest = 1 if entry.scene in ("flight", "pendulum") else len(COLUMNS[entry.scene])
    if len(names) < fewest or "id" not in table.column_names:
        raise OptionError(f"{path} needs the columns id and {', '.join(COLUMNS[entry.scene])}")
    columns = {name: _numbers(table, name, path) for name in table.column_names if name in _NUMERIC}
    ids = np.array([str(value) for value in table.column("id").to_pylist()])
    recordings = _recordings(entry, columns, ids, names, path)
    if not recordings:
        raise OptionError(f"{path} holds no positions")
    notes = off_the_table(recordings, (entry.table.length, entry.table.width), path) if entry.table else ()
    return TrackFolder(entry, recordings, names, notes)


_NUMERIC = {"shot", "frame", "t", "x", "y", "z", "theta1", "theta2", "sigma", "observed"}


def _entry(path: Path) -> SceneEntry:
    try:
        return SceneEntry.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise OptionError(f"{path} cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise OptionError(f"{path} is not JSON: {error}") from error
    except ValidationError as error:
        found = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in found["loc"])
        raise OptionError(f"{path}: {place}: {found['msg'][:1].lower()}{found['msg'][1:]}") from error


def _numbers(table: pa.Table, name: str, path: Path) -> FloatArray:
    try:
        return np.asarray(table.column(name).cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
    except pa.ArrowInvalid as error:
        raise OptionError(f"{path}: the column {name} holds something that is no number") from error


def _recordings(
    entry: SceneEntry, columns: dict[str, FloatArray], ids: NDArray[np.str_], names: tuple[str, ...], path: Path
) -> tuple[Recording, ...]:
    count = len(ids)
    shot = np.nan_to_num(columns.get("shot", np.zeros(count)))
    kept = np.isfinite(np.stack([columns[name] for name in names])).all(axis=0) & (
        columns.get("observed", shot + 1) > 0
    )
    if "frame" not in columns or ("t" not in columns and entry.fps is None):
        raise OptionError(f"{path} needs the column frame, and t, or fps in scene.json")
    t = columns["t"] if "t" in columns else columns["frame"] / (entry.fps or 1.0)
    metres = 1 / entry.px_per_m if entry.units == "px" and entry.px_per_m else 1.0
    if entry.units == "px" and not entry.px_per_m:
        raise OptionError(f"{path}: positions in px need px_per_m in scene.json")
    places = np.stack([columns[name] for name in names], axis=1) * metres
    sigma = columns.get("sigma", np.full(count, np.nan)) * metres
    sigma = np.where(sigma > 0, sigma, _usual_noise(entry))
    found = []
    for number in np.unique(shot):
        here = np.flatnonzero(kept & (shot == number))
        if len(here):
            found.append(
                _recording(int(number), columns["frame"][here], t[here], ids[here], places[here], sigma[here], path)
            )
    return tuple(found)


def _recording(
    shot: int,
    frame: FloatArray,
    t: FloatArray,
    ids: NDArray[np.str_],
    places: FloatArray,
    sigma: FloatArray,
    path: Path,
) -> Recording:
    frames, first, row = np.unique(frame.astype(np.int64), return_index=True, return_inverse=True)
    bodies, body = np.unique(ids, return_inverse=True)
    if np.any(np.diff(t[first]) <= 0):
        raise OptionError(f"{path}: t must grow with frame; in shot {shot} it does not")
    seen = np.full((len(frames), len(bodies), places.shape[1]), np.nan)
    error = np.full((len(frames), len(bodies)), float(np.median(sigma)))
    # of a body that is there twice in a picture, the first row counts
    seen[row[::-1], body[::-1]], error[row[::-1], body[::-1]] = places[::-1], sigma[::-1]
    return Recording(shot, frames, t[first], tuple(str(name) for name in bodies), seen, error)


def _usual_noise(entry: SceneEntry) -> float:
    if entry.image is not None:
        return NOISE_PX / entry.image.px_per_m
    return NOISE_PX / entry.px_per_m if entry.px_per_m else NOISE
