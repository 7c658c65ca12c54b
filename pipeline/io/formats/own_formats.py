"""Our own tables: a track folder (tracks.csv and scene.json), a table of text, and its columns as Parquet or MCAP."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from models.core.errors import OptionError
from pipeline.engine.extras import import_mcap
from pipeline.io.csv_tables import write_columns
from pipeline.io.formats.track_format import MalformedTracks, PointTracks, Provenance, TrackFormat
from pipeline.io.particle_files import NAMED_SCENES
from pipeline.io.strict_json import read_json, write_json
from pipeline.io.text_table import Columns, TextTable, name_columns, read_text_table
from pipeline.io.track_conventions import ANGLE_UNITS, LENGTH_UNITS, TrackScene, interpret_tracks
from pipeline.io.track_folder import SCENE_FILE, TRACKS_FILE, parse_scene_entry

_COORDINATES = ("x", "y", "z", "theta1", "theta2")
# Further columns of tables that formats hold.
_KEPT = ("kind", "score", "x_px", "y_px", "width_px", "height_px", "radius_px", "sigma", "vx", "vy")


def _recognises_folder(path: Path, head: bytes) -> bool:
    """Return whether it is a folder with tracks, or a table of text with a header."""
    if path.is_dir():
        return (path / TRACKS_FILE).is_file()
    return path.suffix.lower() in (".csv", ".tsv", ".txt") and b"\0" not in head


def _read_folder(path: Path) -> PointTracks:
    """Read a track folder, the folder of a run, or a table of text."""
    tracks = path / TRACKS_FILE if path.is_dir() else path
    beside = tracks.with_name(SCENE_FILE)
    scene = read_json(beside, "The scene of the tracks was expected") if beside.is_file() else {}
    return interpret_table(read_text_table(tracks), scene if isinstance(scene, dict) else {})


def interpret_table(table: TextTable, scene: Mapping[str, Any]) -> PointTracks:
    """Interpret a table as tracks, with the scene that is stated beside it.

    Args:
        scene: Content of a scene.json; may be empty.

    Returns:
        The usable rows, in s, and in m or rad where the scene tells so.

    Raises:
        OptionError: The table has no coordinates, or contradicts the scene.
    """
    is_named = scene.get("scene") in NAMED_SCENES
    names = tuple(name for name in _COORDINATES if name in table.columns)
    if not names:
        table.require(("id", "x", "y"))
    fps = scene.get("fps") if isinstance(scene.get("fps"), int | float) else None
    if is_named:
        described = parse_scene_entry(dict(scene), table.path.with_name(SCENE_FILE)).describe_tracks()
        if not set(names) & set(described.coordinates):
            raise OptionError(f"{table.path} has {', '.join(names)}; {described.name} needs {described.coordinates}")
    else:
        described = TrackScene(coordinates=names, fps=fps)
    has_times = "t" in table.columns or described.fps is not None
    if not has_times:  # frames alone are enough for formats of images
        described = TrackScene(described.name, described.coordinates, described.units, described.px_per_m, 1.0)
    rows = interpret_tracks(table, described)
    stated = next((table.units[name] for name in rows.coordinates if name in table.units), scene.get("units"))
    is_px = stated == "px"
    # rows of a named scene are in m or rad; others are as in the file
    scale = rows.unit if is_named else {**ANGLE_UNITS, **LENGTH_UNITS}.get(stated or "", 1.0)
    use = rows.is_usable
    columns: Columns = {"shot": rows.shot[use], "frame": rows.frame[use], "id": rows.ids[use]}
    if has_times:
        columns["t"] = rows.t[use]
    columns |= {name: values[use] for name, values in table.columns.items() if name in _KEPT}
    is_image = is_px and not is_named and set(rows.coordinates) == {"x", "y"}
    columns |= {name: scale * columns[name] for name in ("sigma", "vx", "vy") if name in columns}
    for k, name in enumerate(rows.coordinates):
        columns[f"{name}_px" if is_image else name] = rows.positions[use, k] * (1.0 if is_named else scale)
    is_angle = described.name == "pendulum" if is_named else stated in ANGLE_UNITS
    unit = "rad" if is_angle else "m" if is_named or stated in LENGTH_UNITS else stated or ""
    image = scene.get("image") if isinstance(scene.get("image"), dict) else {}
    size = (image["width_px"], image["height_px"]) if image and {"width_px", "height_px"} <= image.keys() else None
    return PointTracks(columns, "" if is_image else unit, described.fps if has_times else None,
                       scene.get("px_per_m") or (image or {}).get("px_per_m"), size, scene, rows.notes)  # fmt: skip


def list_columns(tracks: PointTracks) -> Columns:
    """List the columns of a tracks.csv: positions in the unit of the scene, else in px."""
    columns = dict(tracks.columns)
    count = len(columns["id"])
    columns = {"shot": np.zeros(count, np.int64), **columns}
    if not any(name in columns for name in _COORDINATES):
        columns["x"], columns["y"] = columns.pop("x_px"), columns.pop("y_px")
    order = ("shot", "frame", "t", "id", *_COORDINATES)
    return {
        name: columns[name] for name in (*order, *(name for name in columns if name not in order)) if name in columns
    }


def describe_scene(tracks: PointTracks, provenance: Provenance) -> dict[str, Any]:
    """Describe tracks as the scene.json beside them; a scene that nobody named is `particles`."""
    is_px = not any(name in tracks.columns for name in _COORDINATES)
    more = {"fps": tracks.fps, "px_per_m": tracks.px_per_m, "units": "px" if is_px else tracks.unit}
    stated = {key: value for key, value in more.items() if value}
    return {"scene": "particles", **tracks.scene, **stated, "converted": dict(provenance)}


def _write_folder(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a track folder."""
    beside = path / SCENE_FILE
    if path.is_dir() and any(path.iterdir()) and not (beside.is_file() and '"converted"' in beside.read_text()):
        raise OptionError(f"{path} holds other files; name a new folder")
    write_columns(list_columns(tracks), path / TRACKS_FILE, "needed")
    write_json(describe_scene(tracks, provenance), beside)


TRACK_FOLDER = TrackFormat("track-folder", "track folder", ("",), _recognises_folder, _read_folder, _write_folder, True)


# Parquet tables with the columns of a tracks.csv, and its scene.json in their metadata.
_KEY = b"trueroll"


def _recognises_parquet(path: Path, head: bytes) -> bool:
    """Return whether it begins as Parquet files do."""
    return head.startswith(b"PAR1") or path.suffix.lower() == ".parquet"


def _read_parquet(path: Path) -> PointTracks:
    """Read a table with the columns of a tracks.csv, or their names in other programs."""
    table = parquet.read_table(path)
    scene = json.loads((table.schema.metadata or {}).get(_KEY, b"{}"))
    columns = {name: table.column(name) for name in table.column_names}
    return interpret_table(name_columns(path, columns, {}, ()), scene)


def _write_parquet(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a table with unrounded numbers."""
    table = pa.table({name: pa.array(values.tolist()) for name, values in list_columns(tracks).items()})
    scene = json.dumps(describe_scene(tracks, provenance), default=str)
    parquet.write_table(table.replace_schema_metadata({_KEY: scene.encode()}), path)


PARQUET = TrackFormat(
    "parquet", "Parquet table", (".parquet",), _recognises_parquet, _read_parquet, _write_parquet, True
)


# MCAP recordings: JSON messages with the columns of a tracks.csv, one per row, or with positions of other programs.
_TOPIC, _SCHEMA, _METADATA = "/tracks", "trueroll.TrackRow", "trueroll"
_MAGIC = b"\x89MCAP0\r\n"


def _recognises_mcap(path: Path, head: bytes) -> bool:
    """Return whether it begins as MCAP files do."""
    return head.startswith(_MAGIC) or path.suffix.lower() == ".mcap"


def _read_mcap(path: Path) -> PointTracks:
    """Read JSON messages: a row, or the position of the body that the topic names, at the time of its log."""
    rows: list[dict[str, Any]] = []
    scene: dict[str, Any] = {}
    with path.open("rb") as file:
        reader = import_mcap().reader.make_reader(file)
        for _, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                row = _flatten(json.loads(message.data))
                rows.append({"id": channel.topic.strip("/"), "t": message.log_time / 1e9, **row})
        for record in reader.iter_metadata():
            if record.name == _METADATA:
                scene = json.loads(record.metadata["scene"])
    if not rows:
        raise MalformedTracks("it has no messages in JSON (diagnose --simulator reads joint states of ROS 2)")
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: pa.array([row.get(name) for row in rows]) for name in names}
    if not scene:
        columns.setdefault("frame", pa.array(np.unique([row["t"] for row in rows], return_inverse=True)[1]))
    return interpret_table(name_columns(path, columns, {}, ()), scene)


def _flatten(message: Mapping[str, Any]) -> dict[str, Any]:
    """Return the plain values of a message, and those of its position."""
    inner = next((message[key] for key in ("pose", "position", "point", "translation")
                  if isinstance(message.get(key), dict)), None)  # fmt: skip
    plain = {key: value for key, value in message.items() if isinstance(value, str | int | float)}
    return plain if inner is None else {**plain, **_flatten(inner)}


def _write_mcap(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one message per row at its time."""
    columns, times = list_columns(tracks), tracks.list_times()
    properties = {
        name: {"type": "number" if values.dtype.kind in "if" else "string"} for name, values in columns.items()
    }
    rows = [
        dict(zip(columns, row, strict=True)) for row in zip(*(one.tolist() for one in columns.values()), strict=True)
    ]
    with path.open("wb") as file:
        writer = import_mcap().writer.Writer(file)
        writer.start(library=f"trueroll {provenance['version']}")
        schema = json.dumps({"type": "object", "properties": properties}).encode()
        channel = writer.register_channel(_TOPIC, "json", writer.register_schema(_SCHEMA, "jsonschema", schema))
        for k in np.argsort(times, kind="stable").tolist():
            stamp = round((times[k] - times.min()) * 1e9)
            values = {name: value for name, value in rows[k].items() if value == value}  # NaN is no JSON
            writer.add_message(channel, stamp, json.dumps(values).encode(), stamp)
        scene = json.dumps(describe_scene(tracks, provenance), default=str)
        writer.add_metadata(_METADATA, {"scene": scene})
        writer.finish()


MCAP = TrackFormat("mcap", "MCAP recording", (".mcap",), _recognises_mcap, _read_mcap, _write_mcap, True)
