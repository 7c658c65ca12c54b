"""Runs a batch from its clips to its summary."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.batch.batch_workers import ClipRunner, JobStream
from pipeline.batch.clip_discovery import assign_folders
from pipeline.batch.clip_job import ClipJob, ClipLimits, ClipResult
from pipeline.batch.index_page import render_index_page
from pipeline.engine.atomic_write import replace_file, write_text
from pipeline.engine.result_cache import ResultCache
from pipeline.reporting.text.text_formatting import escape_text

# Least time between two summaries while clips run, s.
SUMMARY_INTERVAL_S = 2.0


class BatchFollower(Protocol):
    """Follows a batch: a display, a test."""

    def show_progress(self, clip: str, message: dict[str, Any]) -> None:
        """Show a progress message of a clip; see `clip_runner`."""
        ...

    def show_result(self, row: ClipResult, expected: int) -> None:
        """Show that a clip has ended; `expected` clips have been found so far."""
        ...


@dataclass(slots=True)
class Batch:
    """The clips of a folder and their results."""

    root: Path
    out: Path
    cache: ResultCache
    settings: dict[str, Any]
    limits: ClipLimits
    folders: dict[Path, Path] = field(default_factory=dict)
    names: dict[str, Path] = field(default_factory=dict)
    """Clips by the name under which they are printed."""
    rows: dict[str, ClipResult] = field(default_factory=dict)

    def jobs(self, clips: Iterable[Path | None]) -> JobStream:
        """Yield a job per clip, built when it is needed; None is passed on."""
        for clip in clips:
            if clip is not None and clip not in self.folders:
                self.folders = {**assign_folders([*self.folders, clip], self.root, self.out), **self.folders}
            yield None if clip is None else self._build_job(clip)

    def assign_folders(self, clips: Iterable[Path]) -> None:
        """Assign folders to the clips that are present at the start."""
        self.folders = assign_folders(clips, self.root, self.out)

    def _build_job(self, clip: Path) -> ClipJob:
        folder = str(self.folders[clip].absolute())
        name = escape_text(clip.relative_to(self.root))
        while self.names.setdefault(name, clip) != clip:  # two names that are printed alike
            name += "\N{PRIME}"
        cache = str(self.cache.root.absolute())
        return ClipJob(str(clip.absolute()), name, folder, cache, self.cache.mark, self.settings, self.limits)

    @property
    def results(self) -> list[ClipResult]:
        """Results of the clips that have ended, by name."""
        return sorted(self.rows.values(), key=lambda row: row.clip)

    def store_result(self, row: ClipResult) -> ClipResult:
        """Store the result of a clip, with a folder relative to `out` as the user named it."""
        if row.folder:
            row = replace(row, folder=str(self.out / Path(row.folder).relative_to(self.out.absolute())))
        self.rows[row.clip] = row
        return row


def run_batch(batch: Batch, clips: Iterable[Path | None], runner: ClipRunner, follower: BatchFollower) -> None:
    """Run the clips of a batch and keep its summary on disk up to date.

    Args:
        batch: The batch; it stores the results.
        clips: Clips to run; None means that there is none now.
        runner: Runs the clips.
        follower: Follows the batch.
    """
    written = 0.0
    try:
        for row in runner(batch.jobs(clips), follower.show_progress):
            follower.show_result(batch.store_result(row), len(batch.folders))
            if time.monotonic() - written > SUMMARY_INTERVAL_S:
                write_summary(batch.rows.values(), batch.out, whole=False)
                written = time.monotonic()
    finally:
        if batch.rows:
            write_summary(batch.rows.values(), batch.out)


# Columns that differ from run to run. The csv omits them, so that equal results are equal files.
COST_COLUMNS = ("seconds", "compiling", "peak_mb", "tries", "cached")


def write_summary(rows: Iterable[ClipResult], out: Path, *, whole: bool = True) -> None:
    """Write the summary of a batch, ordered by clip; each file is replaced in one step.

    Args:
        rows: Results of the clips.
        out: Folder of the results.
        whole: Whether to write the parquet file and the page too, besides the csv.
    """
    ordered = sorted(rows, key=lambda row: row.clip)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "summary.csv", format_csv(ordered))
    if whole:
        with replace_file(out / "summary.parquet") as fresh:
            pq.write_table(build_table(ordered), fresh)
        write_text(out / "summary.html", render_index_page(ordered, out))


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


def _clean_cell(value: object) -> object:
    """Replace characters of a string that a file cannot hold."""
    return escape_text(value) if isinstance(value, str) else value
