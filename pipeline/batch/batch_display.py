"""Progress of a batch on a terminal: all clips in one line, and a line for each that is at work."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from pipeline.batch.clip_job import Row

WIDTH = 32
"""Signs of a clip's name that are shown."""
DRAWN_HZ = 4
"""Pictures per second: words of clips come half as often, and each costs workers of the same machine time."""


class BatchDisplay:
    """A follower of a batch; a context manager. Nothing is drawn where nobody watches."""

    def __init__(self, console: Console, expected: int | None) -> None:
        columns = (
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
        )  # fmt: skip
        self._bars = Progress(*columns, console=console, disable=not console.is_terminal, refresh_per_second=DRAWN_HZ)
        self._all = self._bars.add_task("clips", total=expected, note="")
        self._clips: dict[str, TaskID] = {}
        self._count = [0, 0]

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for task in self._clips.values():
            self._bars.remove_task(task)
        self._bars.stop()

    def heard(self, clip: str, word: dict[str, Any]) -> None:
        """How far a clip is."""
        if self._bars.disable:
            return
        if clip not in self._clips:
            name = clip if len(clip) <= WIDTH else f"…{clip[1 - WIDTH :]}"
            self._clips[clip] = self._bars.add_task(f"  {escape(name)}", total=100, note="")
        if "shot" in word:
            self._bars.update(self._clips[clip], note="shot {} of {}".format(*word["shot"]))
        elif "stage" in word:
            self._bars.update(self._clips[clip], completed=round(100 * word["share"]), note=word["stage"])

    def done(self, row: Row, expected: int) -> None:
        """A clip has ended."""
        task = self._clips.pop(row.clip, None)
        if task is not None:
            self._bars.remove_task(task)
        self._count[row.status == "failed"] += 1
        note = f"{self._count[1]} failed" if self._count[1] else ""
        self._bars.update(self._all, completed=sum(self._count), total=expected, note=note)
