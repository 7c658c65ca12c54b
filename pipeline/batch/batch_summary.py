"""Writes summary.csv, summary.parquet and summary.html of a batch."""

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

from pipeline.batch.clip_job import ClipResult
from pipeline.engine.atomic_write import replace_file
from pipeline.reporting.pages.page_template import render_template
from pipeline.reporting.text.text_formatting import escape_text

COST_COLUMNS = ("seconds", "compiling", "peak_mb", "tries", "cached")
"""Columns that differ from run to run. The csv omits them, so that equal results are equal files."""


def write_summary(rows: Iterable[ClipResult], out: Path, *, whole: bool = True) -> None:
    """Write the summary of a batch, ordered by clip; each file is replaced in one step.

    Args:
        rows: Results of the clips.
        out: Folder of the results.
        whole: Whether to write the parquet file and the page too, besides the csv.
    """
    ordered = sorted(rows, key=lambda row: row.clip)
    out.mkdir(parents=True, exist_ok=True)
    with replace_file(out / "summary.csv") as fresh:
        fresh.write_text(format_csv(ordered), encoding="utf-8")
    if whole:
        with replace_file(out / "summary.parquet") as fresh:
            pq.write_table(build_table(ordered), fresh)
        with replace_file(out / "summary.html") as fresh:
            fresh.write_text(render_summary_page(ordered, out), encoding="utf-8")


def format_csv(rows: Sequence[ClipResult]) -> str:
    """Format one csv line per clip."""
    names = [field.name for field in fields(ClipResult) if field.name not in COST_COLUMNS]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_clean_cell(getattr(row, name)) for name in names] for row in rows)
    return text.getvalue()


def build_table(rows: Sequence[ClipResult]) -> pa.Table:
    """Build a table with one row per clip, cost columns included."""
    kinds = {"str": pa.string(), "int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
    schema = pa.schema([(field.name, kinds.get(str(field.type), pa.string())) for field in fields(ClipResult)])
    return pa.Table.from_pylist([{k: _clean_cell(v) for k, v in asdict(row).items()} for row in rows], schema=schema)


def render_summary_page(rows: Sequence[ClipResult], out: Path) -> str:
    """Render a page with a line, an image and links per clip."""
    lines = [
        {
            **asdict(row),
            "clip": escape_text(row.clip),
            "sentence": escape_text(row.sentence),
            **_find_page_links(row, out),
        }
        for row in rows
    ]
    done = sum(row.status == "done" for row in rows)
    return render_template(
        "summary.html",
        name=escape_text(out.resolve().name),
        rows=lines,
        done=done,
        seconds=sum(row.seconds for row in rows),
    )


def _find_page_links(row: ClipResult, out: Path) -> dict[str, str]:
    """Return the paths of a clip's report and poster relative to `out`; empty if the clip failed."""
    if row.status != "done":
        return {"report": "", "poster": ""}
    below = os.path.relpath(row.folder, out)
    place = quote(os.fsencode(below))
    shots = sorted(path.parent.name for path in Path(row.folder).glob("shot-*/report.html")) if row.in_shots else []
    first = f"{shots[0]}/" if shots else ""
    return {"report": f"{place}/{first}report.html", "poster": f"{place}/{first}poster.png"}


def _clean_cell(value: object) -> object:
    """Replace characters of a string that a file cannot hold."""
    return escape_text(value) if isinstance(value, str) else value
