"""What is shown while a diagnosis is at work."""

from __future__ import annotations

from io import StringIO

from rich.console import Console

from pipeline.search_display import search_display


def drawn(terminal: bool) -> str:
    console = Console(file=StringIO(), force_terminal=terminal, width=100)
    with search_display(console, "table-01") as watch:
        watch("trying", ("cushion_friction", "slope"))
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def test_a_terminal_is_told_what_is_being_tried() -> None:
    assert "table-01 trying cushion friction and slope" in drawn(terminal=True)


def test_a_file_is_told_nothing() -> None:
    assert drawn(terminal=False) == ""
