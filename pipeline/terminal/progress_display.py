"""Shows on a terminal how far a run is, one bar per stage, and what a command does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from models.core.progress import Progress
from models.numerics.jit import notify_first_compilation


class StageDisplay:
    """A watcher that draws a progress bar per stage on a terminal, as a context manager."""

    def __init__(self, console: Console, title: str = "") -> None:
        note = TextColumn("{task.fields[note]}")
        columns = TextColumn("{task.description:<12}"), BarColumn(), note, TimeElapsedColumn()
        self._bars = Bars(*columns, console=console, disable=not console.is_terminal)
        self._tasks: dict[str, TaskID] = {}
        self._title = title

    def __enter__(self) -> StageDisplay:
        self._bars.start()
        if self._title and self._bars.console.is_terminal:
            self._bars.console.print(self._title, highlight=False, markup=False)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._bars.stop()

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


COMPILING_NOTE = "compiling numerical code for this machine: once, it takes up to a minute"


@contextmanager
def show_activity(console: Console, title: str = "", *, least_interval: float = 0.0) -> Iterator[Callable[[str], None]]:
    """Show what a command does and for how long it has run.

    Args:
        console: Console of the display, on standard error.
        title: Words before each activity.
        least_interval: s between two printed lines, at least; where the console is no terminal, an activity that begins
            within them is not printed.

    Yields:
        A function that is called with each activity.
    """
    lead = f"{title}: " if title else ""
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with (
        Bars(*columns, console=console, disable=not console.is_terminal, transient=True) as bars,
        notify_first_compilation(lambda: console.print(f"{lead}{COMPILING_NOTE}", markup=False)),
    ):
        task = bars.add_task("")
        printed = time.monotonic()

        def update(activity: str) -> None:
            nonlocal printed
            bars.update(task, description=f"{lead}{activity}")
            if not console.is_terminal and time.monotonic() - printed >= least_interval:
                printed = time.monotonic()
                console.print(f"{lead}{activity}", markup=False, soft_wrap=True)

        yield update
