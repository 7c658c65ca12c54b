"""What a diagnosis is trying, on the terminal; where nobody watches, only why its first minute is so long."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from diagnosis.fitting.names import named
from diagnosis.selection.hypotheses import Watch
from models.numerics.first_compilation import compiling_told

COMPILING = "compiling the physics, once per installation: about a minute"


@contextmanager
def search_display(console: Console, title: str = "") -> Iterator[Watch]:
    """A line that says what is tried, and for how long the diagnosis has been at work."""
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bars:
        task = bars.add_task(_said(title, "looking at the tracks", ()))

        def tell(doing: str, names: tuple[str, ...]) -> None:
            bars.update(task, description=_said(title, doing, names))

        with compiling_told(lambda: console.print(_said(title, COMPILING, ()), markup=False)):
            yield tell


def _said(title: str, doing: str, names: tuple[str, ...]) -> str:
    """What is being done, of which table and with which effects."""
    return ": ".join(part for part in (title, doing, " and ".join(map(named, names))) if part)
