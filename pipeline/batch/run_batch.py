"""Runs a batch from its clips to its summary."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from pipeline.batch.batch_summary import write_summary
from pipeline.batch.batch_workers import ClipRunner, JobStream
from pipeline.batch.clip_discovery import assign_folders
from pipeline.batch.clip_job import ClipJob, ClipLimits, ClipResult
from pipeline.engine.result_cache import ResultCache
from pipeline.reporting.text.text_formatting import escape_text

SUMMARY_INTERVAL_S = 2.0
"""Least time between two summaries while clips run, s."""


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


def run_batch(
    batch: Batch,
    clips: Iterable[Path | None],
    runner: ClipRunner,
    follower: BatchFollower,
) -> None:
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
