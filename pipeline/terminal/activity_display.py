"""Shows what a command does on a terminal; one line per activity elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from models.numerics.jit import notify_first_compilation

COMPILING_NOTE = "compiling numerical code for this machine: once, it takes one to two minutes"


@contextmanager
def show_activity(console: Console, title: str = "", *, prints: bool = True) -> Iterator[Callable[[str], None]]:
    """Show what a command does and for how long it has run.

    Args:
        console: Console of the display, on standard error.
        title: Words before each activity.
        prints: Whether activities are printed where the console is no terminal.

    Yields:
        A function that is called with each activity.
    """
    lead = f"{title}: " if title else ""
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with (
        Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bars,
        notify_first_compilation(lambda: console.print(f"{lead}{COMPILING_NOTE}", markup=False)),
    ):
        task = bars.add_task("")

        def update(activity: str) -> None:
            bars.update(task, description=f"{lead}{activity}")
            if prints and not console.is_terminal:
                console.print(activity, markup=False, soft_wrap=True)

        yield update
