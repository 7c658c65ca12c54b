"""Shows the progress of a batch on a terminal: one line for the batch, and one for each running clip."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from pipeline.batch.clip_job import ClipResult

NAME_WIDTH = 32
"""Most characters of a clip's name that are shown."""
REFRESH_HZ = 4
"""Redraws per second. Clips report half as often, and each redraw takes time from workers on the same machine."""


class BatchDisplay:
    """A follower of a batch with progress bars, as a context manager. It draws nothing unless on a terminal."""

    def __init__(self, console: Console, expected: int | None) -> None:
        columns = (
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
        )  # fmt: skip
        self._bars = Progress(*columns, console=console, disable=not console.is_terminal, refresh_per_second=REFRESH_HZ)
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

    def show_progress(self, clip: str, message: dict[str, Any]) -> None:
        """Show the progress of a clip; see `clip_runner` for the messages."""
        if self._bars.disable:
            return
        if clip not in self._clips:
            name = clip if len(clip) <= NAME_WIDTH else f"…{clip[1 - NAME_WIDTH :]}"
            self._clips[clip] = self._bars.add_task(f"  {escape(name)}", total=100, note="")
        if "shot" in message:
            self._bars.update(self._clips[clip], note="shot {} of {}".format(*message["shot"]))
        elif "stage" in message:
            self._bars.update(self._clips[clip], completed=round(100 * message["share"]), note=message["stage"])

    def show_result(self, row: ClipResult, expected: int) -> None:
        """Count a clip that has ended, and remove its line."""
        task = self._clips.pop(row.clip, None)
        if task is not None:
            self._bars.remove_task(task)
        self._count[row.status == "failed"] += 1
        note = f"{self._count[1]} failed" if self._count[1] else ""
        self._bars.update(self._all, completed=sum(self._count), total=expected, note=note)
