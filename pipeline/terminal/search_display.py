"""Shows the progress of a diagnosis on a terminal; elsewhere only a note while the physics is compiled.

The time left is that of the steps so far, times the number of steps that usually follow: right within a factor of two.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from diagnosis.fitting.display_names import format_cause
from diagnosis.selection.hypotheses import ProgressCallback, SearchOutlook
from pipeline.terminal.activity_display import show_activity


@contextmanager
def show_search_progress(console: Console, title: str = "") -> Iterator[ProgressCallback]:
    """Show what the diagnosis does and for how long it has run.

    Args:
        console: Console of the display.
        title: Name of the table, if there are several.

    Yields:
        A function that is called with the activity, the effects that are tried, and the outlook of the search.
    """
    begun = time.monotonic()
    with show_activity(console, title, prints=False) as show:

        def update(activity: str, names: tuple[str, ...], outlook: SearchOutlook) -> None:
            effects = f": {' and '.join(map(format_cause, names))}" if names else ""
            show(f"{activity}{effects}{_format_outlook(outlook, time.monotonic() - begun)}")

        show("looking at the tracks")
        yield update


def _format_outlook(outlook: SearchOutlook, seconds: float) -> str:
    """Format the best hypothesis so far and the estimated time left after `seconds` as the rest of a line."""
    parts = []
    if outlook.best is not None:
        parts.append(f"best so far: {' and '.join(map(format_cause, outlook.best or ('none',)))}")
    if outlook.steps_done:
        parts.append(f"about {seconds / outlook.steps_done * outlook.steps_left:.0f} s left")
    return f" ({'; '.join(parts)})" if parts else ""
