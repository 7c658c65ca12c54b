"""summary.csv, summary.parquet and summary.html of a batch."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.batch.clip_job import Row
from pipeline.engine.atomic_write import aside
from pipeline.reporting.pages.page_template import render
from pipeline.reporting.text.sentences import told

COSTS = ("seconds", "peak_mb", "tries", "cached")
"""What differs from run to run: not in the csv, so that equal results are equal files."""


def write_summary(rows: Iterable[Row], out: Path, *, whole: bool = True) -> None:
    """Write summary.csv, ordered by clip, each file replaced in one step; with `whole` the parquet and the page too."""
    ordered = sorted(rows, key=lambda row: row.clip)
    out.mkdir(parents=True, exist_ok=True)
    with aside(out / "summary.csv") as fresh:
        fresh.write_text(as_csv(ordered), encoding="utf-8")
    if whole:
        with aside(out / "summary.parquet") as fresh:
            pq.write_table(as_table(ordered), fresh)
        with aside(out / "summary.html") as fresh:
            fresh.write_text(as_page(ordered, out), encoding="utf-8")


def as_csv(rows: Sequence[Row]) -> str:
    """A line per clip."""
    names = [field.name for field in fields(Row) if field.name not in COSTS]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_cell(getattr(row, name)) for name in names] for row in rows)
    return text.getvalue()


def as_table(rows: Sequence[Row]) -> pa.Table:
    """A row per clip, with what each cost."""
    kinds = {"str": pa.string(), "int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
    schema = pa.schema([(field.name, kinds.get(str(field.type), pa.string())) for field in fields(Row)])
    return pa.Table.from_pylist([{k: _cell(v) for k, v in asdict(row).items()} for row in rows], schema=schema)


def as_page(rows: Sequence[Row], out: Path) -> str:
    """One page with a line and a picture per clip, and links to what was made of it."""
    lines = [
        {**asdict(row), "clip": told(row.clip), "sentence": told(row.sentence), **_links(row, out)} for row in rows
    ]
    done = sum(row.status == "done" for row in rows)
    return render(
        "summary.html", name=told(out.resolve().name), rows=lines, done=done, seconds=sum(row.seconds for row in rows)
    )


def _links(row: Row, out: Path) -> dict[str, str]:
    """Where the page finds a clip's report and picture, seen from `out`; empty where there is none."""
    if row.status != "done":
        return {"report": "", "poster": ""}
    below = os.path.relpath(row.folder, out)
    place = quote(os.fsencode(below))
    shots = sorted(path.parent.name for path in Path(row.folder).glob("shot-*/report.html")) if row.in_shots else []
    first = f"{shots[0]}/" if shots else ""
    return {"report": f"{place}/{first}report.html", "poster": f"{place}/{first}poster.png"}


def _cell(value: object) -> object:
    """As any file can hold it."""
    return told(value) if isinstance(value, str) else value
