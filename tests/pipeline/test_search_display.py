"""What is shown while a diagnosis is at work."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import numba
import pytest
from rich.console import Console

from pipeline.terminal.search_display import COMPILING, search_display


@numba.njit
def thrown_away(x: float) -> float:
    return x + 1


def drawn(terminal: bool) -> str:
    console = Console(file=StringIO(), force_terminal=terminal, width=100)
    with search_display(console, "table-01") as watch:
        watch("trying", ("cushion_friction", "slope"))
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def test_a_terminal_is_told_what_is_being_tried() -> None:
    assert "table-01: trying: cushion friction and slope" in drawn(terminal=True)


def test_a_file_is_told_nothing() -> None:
    assert drawn(terminal=False) == ""


@pytest.mark.parametrize("terminal", [True, False])
def test_the_first_minute_is_explained_once_also_where_nobody_watches(
    terminal: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    kept = numba.njit(cache=True)(thrown_away.py_func)
    console = Console(file=StringIO(), force_terminal=terminal, width=100)
    with search_display(console):
        thrown_away(1.0)
        assert isinstance(console.file, StringIO)
        assert COMPILING not in console.file.getvalue(), "what every process compiles anew is no new installation"
        kept(1.0)
        kept(1)
    assert console.file.getvalue().count(COMPILING) == 1
