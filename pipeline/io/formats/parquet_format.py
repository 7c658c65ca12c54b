"""Parquet tables with the columns of a tracks.csv, and its scene.json in their metadata."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet

from pipeline.io.formats.text_format import describe_scene, interpret_table, list_columns
from pipeline.io.formats.track_format import PointTracks, Provenance, TrackFormat
from pipeline.io.text_table import name_columns

_KEY = b"trueroll"


def recognises(path: Path, head: bytes) -> bool:
    """Return whether it begins as Parquet files do."""
    return head.startswith(b"PAR1") or path.suffix.lower() == ".parquet"


def read(path: Path) -> PointTracks:
    """Read a table with the columns of a tracks.csv, or their names in other programs."""
    table = parquet.read_table(path)
    scene = json.loads((table.schema.metadata or {}).get(_KEY, b"{}"))
    columns = {name: table.column(name) for name in table.column_names}
    return interpret_table(name_columns(path, columns, {}, ()), scene)


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a table with unrounded numbers."""
    table = pa.table({name: pa.array(values.tolist()) for name, values in list_columns(tracks).items()})
    scene = json.dumps(describe_scene(tracks, provenance), default=str)
    parquet.write_table(table.replace_schema_metadata({_KEY: scene.encode()}), path)


FORMAT = TrackFormat("parquet", "Parquet table", (".parquet",), recognises, read, write, True)
