"""What a diagnosis is trying, on the terminal; nothing where nobody watches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from diagnosis.hypotheses import Watch
from pipeline.gap_words import plain


@contextmanager
def search_display(console: Console, title: str = "") -> Iterator[Watch]:
    """A line that says what is tried, and for how long the diagnosis has been at work."""
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bars:
        task = bars.add_task(title)

        def tell(doing: str, names: tuple[str, ...]) -> None:
            bars.update(task, description=f"{title} {doing} {' and '.join(map(plain, names))}".strip())

        yield tell
