"""Reading of track folders (tracks.csv and scene.json of any scene) and run folders as recordings for a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from models.core.constants import GRAVITY
from models.core.errors import OptionError
from models.core.recording import Recording, ReferenceFrame
from models.core.tracks import TABLE_PLANE
from models.core.typing import FloatArray
from models.estimation.rally.recorded_flights import LEAST_PLACES, record_flights
from pipeline.io.run_folder import drop_repeated_clips
from pipeline.io.saved_shot import has_shot, holds_rally, read_rally, read_shot
from pipeline.io.strict_json import format_first_error, read_json
from pipeline.io.surroundings import WallsEntry, build_inputs, find_input_columns
from pipeline.io.text_table import TextTable, build_row_grid, read_text_table
from pipeline.io.track_conventions import (
    LENGTH_UNITS,
    MAX_NUMBER,
    MAX_OVERSHOOT,
    MAX_SHARE_OFF_TABLE,
    MAX_TABLE_LENGTH,
    UNIT_NAMES,
    TrackRows,
    TrackScene,
    find_off_table,
    interpret_tracks,
)
from pipeline.reporting.text.text_formatting import escape_text

PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegativeNumber = Annotated[float, Field(ge=0, allow_inf_nan=False)]

# px, initial standard deviation of positions without a sigma; the diagnosis re-estimates it.
DEFAULT_NOISE_PX = 0.3
# m or rad, the same for scenes without an image.
DEFAULT_NOISE = 1e-3
# Largest relative difference of two measured sizes of the same table.
_SIZE_TOLERANCE = 0.05
# Frame of reference of each scene; flight and pendulum may lack coordinates.
SCENE_FRAMES = {
    "billiards": TABLE_PLANE,
    "slide": ReferenceFrame(("x", "y"), "m", "in a plane"),
    "flight": ReferenceFrame(("x", "y", "z"), "m", "in the air"),
    "pendulum": ReferenceFrame(("theta1", "theta2"), "rad", "from the vertical"),
}


class SceneTableEntry(BaseModel):
    """Playing surface between the cushion noses, m."""

    model_config = ConfigDict(extra="allow")
    length: PositiveNumber
    width: PositiveNumber


class ImageEntry(BaseModel):
    """Position and scale of the scene in the image."""

    model_config = ConfigDict(extra="allow")
    px_per_m: PositiveNumber
    origin_px: tuple[float, float] = (0.0, 0.0)
    width_px: PositiveNumber
    height_px: PositiveNumber


class SceneEntry(BaseModel):
    """Part of a scene.json that a diagnosis uses."""

    model_config = ConfigDict(extra="allow")
    scene: Literal["billiards", "flight", "pendulum", "slide"] = "billiards"
    units: Literal["m", "cm", "mm", "in", "ft", "km", "px", "rad", "deg"] | None = None
    px_per_m: PositiveNumber | None = None
    fps: PositiveNumber | None = None
    table: SceneTableEntry | None = None
    ball_radius: PositiveNumber | None = None
    image: ImageEntry | None = None
    gravity: PositiveNumber = GRAVITY
    walls: WallsEntry = None
    radius: NonNegativeNumber = 0.0
    model: list[str] | dict[str, Any] | None = None
    laws: dict[str, Any] | None = None

    def describe_tracks(self, has_inputs: bool = False) -> TrackScene:
        """Describe what is stated about the tracks beside it."""
        size = None if self.table is None else (self.table.length, self.table.width)
        scale = self.px_per_m or (self.image.px_per_m if self.image is not None else None)
        coordinates = SCENE_FRAMES[self.scene].coordinates
        return TrackScene(self.scene, coordinates, self.units, scale, self.fps, size, self.gravity, has_inputs)


@dataclass(frozen=True, slots=True)
class TrackFolder:
    """Recordings of one or several track folders, with their scene."""

    entry: SceneEntry
    recordings: tuple[Recording, ...]
    """One recording or more, in one frame of reference."""
    inputs: tuple[str, ...] = ()
    """Column names of the known inputs."""
    notes: tuple[str, ...] = ()
    """Sentences on anomalies of the tracks."""
    origins: Mapping[int, str] = field(default_factory=dict)
    """Folder and number there by shot, if there are several folders or shots are pieces of a recording."""

    @property
    def reference(self) -> ReferenceFrame:
        """Frame of reference of the recordings."""
        return self.recordings[0].reference


def read_track_folders(folders: Sequence[Path]) -> TrackFolder:
    """Read all shots of several folders and number them consecutively.

    Args:
        folders: Run folders or track folders.

    Returns:
        The recordings with their common scene.

    Raises:
        OptionError: A folder cannot be used, is given twice, or has another scene or table than the others.
    """
    places = [folder.resolve() for folder in folders]
    repeated = next((folder for k, folder in enumerate(folders) if places[k] in places[:k]), None)
    if repeated is not None:
        raise OptionError(f"{repeated} was given twice, so its shots would confirm themselves; name every folder once")
    read = [_read_track_folder(folder) for folder in folders]
    first = read[0]
    for folder, other in zip(folders, read, strict=True):
        if other.reference != first.reference:
            raise OptionError(
                f"{folder} has {other.reference}, and {folders[0]} has {first.reference}; diagnose them separately"
            )
        surroundings = [(one.entry.walls, one.entry.radius, one.inputs) for one in (other, first)]
        if surroundings[0] != surroundings[1]:
            raise OptionError(
                f"{folder} states other walls, radius or known inputs than {folders[0]}; diagnose them separately"
            )
        if _is_other_table(first.entry, other.entry):
            raise OptionError(
                f"{folder} has {_describe_table(other.entry)}, {folders[0]} has"
                f" {_describe_table(first.entry)}; diagnose each table separately"
            )
    used, repetitions = drop_repeated_clips(folders)
    pairs = [(one, folder) for one, folder in zip(read, folders, strict=True) if folder in used]
    shots, repeated_shots = _drop_repeated_shots(
        [
            (one, folder.resolve().name + f", shot {one.shot}" * (len(own.recordings) > 1))
            for own, folder in pairs
            for one in own.recordings
        ]
    )
    notes = (*repetitions, *repeated_shots, *(note for own, _ in pairs for note in own.notes))
    if len(pairs) == 1:
        return replace(first, recordings=tuple(one for one, _ in shots), notes=notes)
    numbered = tuple(replace(one, shot=number) for number, (one, _) in enumerate(shots))
    origins = {number: name for number, (_, name) in enumerate(shots)}
    return replace(first, recordings=numbered, notes=notes, origins=origins)


def _drop_repeated_shots(shots: list[tuple[Recording, str]]) -> tuple[list[tuple[Recording, str]], tuple[str, ...]]:
    """Drop the shots whose rows are those of an earlier one; also return a sentence that names them, if there are any.

    They are one observation of one motion, and would confirm themselves.
    """
    first: dict[tuple[object, ...], str] = {}
    used: list[tuple[Recording, str]] = []
    names: list[str] = []
    for one, name in shots:
        arrays = one.t, one.positions, np.zeros(0) if one.inputs is None else one.inputs
        rows = one.bodies, *(values.tobytes() for values in arrays)
        if rows in first:
            names.append(f"{name} has the same rows as {first[rows]}")
        else:
            first[rows] = name
            used.append((one, name))
    return used, (f"{'; '.join(names)}: such shots are counted once",) if names else ()


def _is_other_table(one: SceneEntry, other: SceneEntry) -> bool:
    """Return whether two folders state different table sizes or ball radii."""
    sizes = [(entry.table.length, entry.table.width) for entry in (one, other) if entry.table is not None]
    balls = [(entry.ball_radius,) for entry in (one, other) if entry.ball_radius is not None]
    return any(len(pair) == 2 and not np.allclose(pair[0], pair[1], rtol=_SIZE_TOLERANCE) for pair in (sizes, balls))


def _describe_table(entry: SceneEntry) -> str:
    """Format the size of the table and of the balls."""
    size = (
        f"a table of {entry.table.length:.3g} x {entry.table.width:.3g} m" if entry.table else "a table of unknown size"
    )
    return f"{size} with balls of {2e3 * entry.ball_radius:.3g} mm" if entry.ball_radius else size


def _read_track_folder(folder: Path) -> TrackFolder:
    require_track_files(folder)
    if holds_rally(folder):
        return _read_rally_flights(folder)
    entry = parse_scene_entry(read_json(folder / SCENE_FILE, "A track folder has a scene.json"), folder / SCENE_FILE)
    path = folder / "tracks.csv"
    # the table of a run folder rounds the observations of its shot
    recordings, inputs, notes = (
        ((read_shot(folder).tracks.record_positions(),), (), ()) if has_shot(folder) else _read_table(entry, path)
    )
    if not any(one.is_observed.any() for one in recordings):
        raise OptionError(f"{path} has no positions")
    if entry.table:
        places = np.concatenate([one.positions[one.is_observed][:, :2] for one in recordings])
        notes += require_positions_on_table(places, (entry.table.length, entry.table.width), path)
    return TrackFolder(entry, recordings, inputs, notes)


def _read_rally_flights(folder: Path) -> TrackFolder:
    """Read the flights of a rally, as its camera saw them; the model is the law of flight of its sport."""
    rally = read_rally(folder)
    flights = record_flights(rally)
    if not flights:
        raise OptionError(f"{folder} has no flight that was seen in {LEAST_PLACES} frames after its turn-over")
    item = rally.scene.sport.object
    # what lifts a shuttle is over with its turn-over
    model = ["air_drag", *(["magnus"] if item.lift and not item.turn_length else [])]
    note = f"{folder} holds a rally that one camera saw: {len(flights)} flights are compared in the image, in px"
    # one drag is fitted to all flights: those of another shuttle or ball, which has another radius, are refused
    return TrackFolder(SceneEntry(scene="flight", radius=item.radius, model=model), flights, notes=(note,))


def _read_table(entry: SceneEntry, path: Path) -> tuple[tuple[Recording, ...], tuple[str, ...], tuple[str, ...]]:
    """Read the recordings of a tracks.csv, the names of its columns of known inputs, and what was assumed."""
    table = read_text_table(path)
    reference = SCENE_FRAMES[entry.scene]
    names = tuple(name for name in reference.coordinates if name in table.columns)
    fewest = 1 if entry.scene in ("flight", "pendulum") else len(reference.coordinates)
    if len(names) < fewest:
        raise OptionError(
            f"{path} needs the columns id and {', '.join(reference.coordinates)}, a row for each body and time; it has"
            f" {', '.join(table.columns) or 'no numbers'}: rename them, or try trueroll convert --scene {entry.scene}"
        )
    inputs = find_input_columns(entry.scene, names, table.columns, path)
    rows = interpret_tracks(table, entry.describe_tracks(bool(inputs)))
    recordings = _split_recordings(entry, table, rows, replace(reference, coordinates=names), inputs)
    return recordings, inputs, rows.notes


def parse_scene_entry(document: Any, path: Path) -> SceneEntry:
    """Parse the part of a scene.json that a diagnosis uses.

    Args:
        document: Content of the file.
        path: The file, for the message.

    Returns:
        The entry.

    Raises:
        OptionError: A value cannot be used.
    """
    try:
        return SceneEntry.model_validate(document)
    except ValidationError as error:
        raise OptionError(f"{path}: {format_first_error(error)}") from error


def _split_recordings(
    entry: SceneEntry, table: TextTable, rows: TrackRows, reference: ReferenceFrame, inputs: tuple[str, ...]
) -> tuple[Recording, ...]:
    stated = table.columns.get("sigma", np.full(len(rows.t), np.nan)) * rows.unit
    is_stated = (stated > 1 / MAX_NUMBER) & (stated < MAX_NUMBER)
    scale = entry.image.px_per_m if entry.image is not None else entry.px_per_m
    sigma = np.where(is_stated, stated, DEFAULT_NOISE_PX / scale if scale else DEFAULT_NOISE)
    recordings = []
    for number in np.unique(rows.shot[rows.is_usable]).tolist():
        here = np.flatnonzero(rows.is_usable & (rows.shot == number))
        grid = build_row_grid(rows.frame[here], rows.ids[here], sorted(set(rows.ids[here].tolist())))
        frames, times, bodies = rows.frame[here][grid.first], rows.t[here][grid.first], grid.bodies
        positions, error = grid.scatter(rows.positions[here]), grid.scatter(sigma[here])
        given = None
        if inputs:
            # also rows without a position
            own = np.flatnonzero(rows.shot == number)
            samples, place = {name: table.columns[name][own] for name in inputs}, f"{table.path}, shot {number}"
            given = build_inputs(entry.scene, samples, rows.t[own], rows.ids[own], bodies, times, rows.unit, place)
        is_all_stated = bool(is_stated[here].all())
        recordings.append(Recording(number, frames, times, bodies, positions, error, reference, is_all_stated, given))
    return tuple(recordings)


TRACKS_FILE, SCENE_FILE = "tracks.csv", "scene.json"


def require_track_files(folder: Path) -> None:
    """Raise an OptionError if a folder lacks a file of a track folder; it names the file, the place and the remedy."""
    if not folder.is_dir():
        raise OptionError(
            f"There is no folder {escape_text(folder)}; name one that trueroll run wrote, or one of your own with"
            f" {TRACKS_FILE} and {SCENE_FILE}, or convert a file of tracks to one (trueroll convert)"
        )
    missing = [name for name in (TRACKS_FILE, SCENE_FILE) if not (folder / name).is_file()]
    if not missing:
        return
    lacks = f"There is no {' and no '.join(missing)} in {escape_text(folder)}"
    below = [path.parent for path in folder.glob(f"*/{TRACKS_FILE}") if (path.parent / SCENE_FILE).is_file()]
    if below:
        raise OptionError(f"{lacks}, but in {len(below)} of its folders; name these: {escape_text(folder)}/*/")
    raise OptionError(
        f"{lacks}; a diagnosis needs {TRACKS_FILE} (positions of the balls) and {SCENE_FILE} (the table): name a"
        " folder that trueroll run wrote, or write them as described in docs/reference/file-formats.md"
    )


def require_positions_on_table(places: FloatArray, size: tuple[float, float], path: Path) -> tuple[str, ...]:
    """Require that positions lie on the table.

    Args:
        places: Positions (K, 2), m.
        size: Length and width of the table, m.
        path: Their tracks.csv, for the messages.

    Returns:
        A note with the number of positions off the table; empty if there are none.

    Raises:
        OptionError: The table is too large to be in metres, or too many positions are off it.
    """
    if max(size) > MAX_TABLE_LENGTH:
        raise OptionError(
            f"{escape_text(path.with_name(SCENE_FILE))}: the table is {size[0]:g} x {size[1]:g} m; lengths must be"
            " in metres"
        )
    away = find_off_table(places, size)
    worst = int(np.argmax(away.mean(axis=0)))
    if away[:, worst].mean() > MAX_SHARE_OFF_TABLE:
        low, high = float(places[:, worst].min()), float(places[:, worst].max())
        axis, side, most = "xy"[worst], ("length", "width")[worst], size[worst]
        raise OptionError(
            f"{escape_text(path)}: {axis} goes from {low:.3g} to {high:.3g} m, but {SCENE_FILE} gives the table a"
            f" {side} of {most:g} m, so that {axis} lies between 0 and {most:g}{_suggest_unit(high, most)}"
        )
    count = int(away.any(axis=1).sum())
    return (f"{count} of {len(places)} positions of {escape_text(path)} are off the table",) if count else ()


def _suggest_unit(high: float, most: float) -> str:
    """Suggest the unit in which the largest value would be on the table; of several, the one that fills it best."""
    fits = [(high * size, unit) for unit, size in LENGTH_UNITS.items() if 0 < high * size <= most * (1 + MAX_OVERSHOOT)]
    if not fits:
        return "; correct the one or the other"
    unit = max(fits)[1]
    return f'; if it is in {UNIT_NAMES[unit]}, write "units": "{unit}" into {SCENE_FILE}'
