"""MCAP recordings: JSON messages with the columns of a tracks.csv, one per row, or with positions of other programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from models.core.errors import OptionError
from pipeline.extras import name_remedy
from pipeline.io.formats.text_format import describe_scene, interpret_table, list_columns
from pipeline.io.formats.track_format import MalformedTracks, PointTracks, Provenance, TrackFormat
from pipeline.io.text_table import name_columns

_TOPIC, _SCHEMA, _METADATA = "/tracks", "trueroll.TrackRow", "trueroll"
_MAGIC = b"\x89MCAP0\r\n"


def recognises(path: Path, head: bytes) -> bool:
    """Return whether it begins as MCAP files do."""
    return head.startswith(_MAGIC) or path.suffix.lower() == ".mcap"


def _import_mcap() -> Any:
    try:
        import mcap.reader
        import mcap.writer
    except ImportError as error:
        raise OptionError(f"MCAP files need a package that is not installed; {name_remedy('simulators')}") from error
    return mcap


def read(path: Path) -> PointTracks:
    """Read JSON messages: a row, or the position of the body that the topic names, at the time of its log."""
    rows: list[dict[str, Any]] = []
    scene: dict[str, Any] = {}
    with path.open("rb") as file:
        reader = _import_mcap().reader.make_reader(file)
        for _, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                row = _flatten(json.loads(message.data))
                rows.append({"id": channel.topic.strip("/"), "t": message.log_time / 1e9, **row})
        for record in reader.iter_metadata():
            if record.name == _METADATA:
                scene = json.loads(record.metadata["scene"])
    if not rows:
        raise MalformedTracks("it has no messages in JSON; convert the recording to JSON messages first")
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


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one message per row at its time."""
    columns, times = list_columns(tracks), tracks.list_times()
    properties = {
        name: {"type": "number" if values.dtype.kind in "if" else "string"} for name, values in columns.items()
    }
    rows = [
        dict(zip(columns, row, strict=True)) for row in zip(*(one.tolist() for one in columns.values()), strict=True)
    ]
    with path.open("wb") as file:
        writer = _import_mcap().writer.Writer(file)
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


FORMAT = TrackFormat("mcap", "MCAP recording", (".mcap",), recognises, read, write, True)
