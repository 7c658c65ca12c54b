"""Shows how many shots of a table are fitted, on a terminal; elsewhere one line per shot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from models.numerics.first_compilation import notify_first_compilation
from pipeline.terminal.search_display import COMPILING_NOTE


@contextmanager
def show_shot_fits(console: Console, last: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many shots are fitted.

    Args:
        console: Console of the display.
        last: What is done once all shots are fitted.

    Yields:
        A function that is called with the number of fitted shots and that of all.
    """
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with (
        Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bars,
        notify_first_compilation(lambda: console.print(COMPILING_NOTE, markup=False)),
    ):
        task = bars.add_task("fitting shots")

        def update(done: int, count: int) -> None:
            text = last if done == count else "fitting shots"
            bars.update(task, completed=done, total=count, description=text)
            if not console.is_terminal:
                console.print(text if done == count else f"fitting shot {done + 1} of {count}", markup=False)

        yield update
