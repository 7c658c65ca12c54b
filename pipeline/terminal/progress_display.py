"""Shows the progress of a run on a terminal, one line per stage; it shows nothing elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from models.core.progress import Progress


class StageDisplay:
    """A watcher that draws a progress bar per stage on a terminal, as a context manager."""

    def __init__(self, console: Console, title: str = "") -> None:
        columns = (
            TextColumn("{task.description:<12}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
        )
        self._bars = Bars(*columns, console=console, disable=not console.is_terminal)
        self._tasks: dict[str, TaskID] = {}
        self._title = title

    def __enter__(self) -> StageDisplay:
        self._bars.start()
        if self._title:
            self._print_title(self._title)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._bars.stop()

    def _print_title(self, title: str) -> None:
        if self._bars.console.is_terminal:
            self._bars.console.print(title, highlight=False, markup=False)

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Stop drawing inside the `with` block, which may print; afterwards only unfinished stages are drawn."""
        self._bars.stop()
        try:
            yield
        finally:
            for task in self._bars.tasks:
                self._bars.update(task.id, visible=not task.finished)
            self._bars.start()

    def start_stage(self, stage: str) -> Progress:
        """Add the bar of a stage; the result moves it."""
        task = self._bars.add_task(stage, total=1.0, note="")
        self._tasks[stage] = task
        return lambda share: self._bars.update(task, completed=share)

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Complete the bar of a stage with its time."""
        note = "cached" if cached else f"{seconds:.1f} s"
        self._bars.update(self._tasks[stage], completed=1.0, note=note)
        self._bars.stop_task(self._tasks[stage])
