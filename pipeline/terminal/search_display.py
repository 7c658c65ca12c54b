"""Shows the progress of a diagnosis on a terminal; elsewhere only a note while the physics is compiled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from diagnosis.fitting.display_names import format_cause
from diagnosis.selection.hypotheses import ProgressCallback
from models.numerics.first_compilation import notify_first_compilation

COMPILING_NOTE = "compiling the physics, once per installation: it takes one to four minutes"


@contextmanager
def show_search_progress(console: Console, title: str = "") -> Iterator[ProgressCallback]:
    """Show what the diagnosis does and for how long it has run.

    Args:
        console: Console of the display.
        title: Name of the table, if there are several.

    Yields:
        A function that is called with the activity and the effects that are tried.
    """
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bars:
        task = bars.add_task(_format_activity(title, "looking at the tracks", ()))

        def update(activity: str, names: tuple[str, ...]) -> None:
            bars.update(task, description=_format_activity(title, activity, names))

        with notify_first_compilation(lambda: console.print(_format_activity(title, COMPILING_NOTE, ()), markup=False)):
            yield update


def _format_activity(title: str, activity: str, names: tuple[str, ...]) -> str:
    """Format table, activity and effects as one line."""
    return ": ".join(part for part in (title, activity, " and ".join(map(format_cause, names))) if part)
