"""A batch from its clips to its summary."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from pipeline.batch.batch_summary import write_summary
from pipeline.batch.batch_workers import Crew, Jobs
from pipeline.batch.clip_discovery import folders_of
from pipeline.batch.clip_job import Job, Limits, Row
from pipeline.engine.result_cache import Cache
from pipeline.reporting.text.sentences import told

WRITE_S = 2.0
"""s between two summaries while clips are run."""


class Follower(Protocol):
    """Who follows a batch."""

    def heard(self, clip: str, word: dict[str, Any]) -> None:
        """How far a clip is."""
        ...

    def done(self, row: Row, expected: int) -> None:
        """A clip has ended; so many are known by now."""
        ...


@dataclass(slots=True)
class Batch:
    """The clips of a folder that are or will be run, and how they went."""

    root: Path
    out: Path
    cache: Cache
    settings: dict[str, Any]
    limits: Limits
    folders: dict[Path, Path] = field(default_factory=dict)
    names: dict[str, Path] = field(default_factory=dict)
    """Which clip is told by which name."""
    rows: dict[str, Row] = field(default_factory=dict)

    def jobs(self, clips: Iterable[Path | None]) -> Jobs:
        """A job per clip, made when it is wanted."""
        for clip in clips:
            if clip is not None and clip not in self.folders:
                self.folders = {**folders_of([*self.folders, clip], self.root, self.out), **self.folders}
            yield None if clip is None else self._job(clip)

    def know(self, clips: Iterable[Path]) -> None:
        """Clips that are known from the beginning get their folders together."""
        self.folders = folders_of(clips, self.root, self.out)

    def _job(self, clip: Path) -> Job:
        folder = str(self.folders[clip].absolute())
        name = told(clip.relative_to(self.root))
        while self.names.setdefault(name, clip) != clip:  # two that are told alike
            name += "\N{PRIME}"
        cache = str(self.cache.root.absolute())
        return Job(str(clip.absolute()), name, folder, cache, self.cache.mark, self.settings, self.limits)

    @property
    def ended(self) -> list[Row]:
        """How the clips went that have ended, by name."""
        return sorted(self.rows.values(), key=lambda row: row.clip)

    def note(self, row: Row) -> Row:
        """Keep how a clip went, its folder named as the user named `out`."""
        if row.folder:
            row = replace(row, folder=str(self.out / Path(row.folder).relative_to(self.out.absolute())))
        self.rows[row.clip] = row
        return row


def run_batch(
    batch: Batch,
    clips: Iterable[Path | None],
    crew: Crew,
    follower: Follower,
) -> None:
    """Run the clips, with a summary on disk at all times: what is done is told even where the rest never ends."""
    written = 0.0
    try:
        for row in crew(batch.jobs(clips), follower.heard):
            follower.done(batch.note(row), len(batch.folders))
            if time.monotonic() - written > WRITE_S:
                write_summary(batch.rows.values(), batch.out, whole=False)
                written = time.monotonic()
    finally:
        if batch.rows:
            write_summary(batch.rows.values(), batch.out)
