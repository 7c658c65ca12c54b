"""The progress display of a diagnosis."""

from __future__ import annotations

import time
from io import StringIO
from pathlib import Path

import numba
import pytest
from rich.console import Console

from diagnosis.selection.hypotheses import SearchOutlook
from models.numerics.jit import compile_kernel
from pipeline.actions.diagnose_batch import show_search_progress
from pipeline.terminal.progress_display import COMPILING_NOTE

NOTHING_YET = SearchOutlook()


@numba.njit
def compile_each_time(x: float) -> float:
    return x + 1


def show_activity(terminal: bool, outlook: SearchOutlook = NOTHING_YET) -> str:
    console = Console(file=StringIO(), force_terminal=terminal, width=100)
    with show_search_progress(console, "table-01") as watch:
        watch("trying", ("cushion_friction", "slope"), outlook)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def test_a_terminal_shows_which_effects_are_tried() -> None:
    assert "table-01: trying: cushion friction and slope" in show_activity(terminal=True)


def test_a_terminal_shows_the_best_answer_so_far_and_the_time_left() -> None:
    text = show_activity(terminal=True, outlook=SearchOutlook(("slope",), 3, 9))
    assert "(best so far: slope; about 0 s left)" in text
    assert "best so far: nothing" in show_activity(terminal=True, outlook=SearchOutlook((), 3, 9))


def test_a_file_gets_a_line_every_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    console = Console(file=StringIO(), force_terminal=False, width=100)
    with show_search_progress(console, "table-01") as watch:
        for clock[0], effect in ((101.0, "lens"), (111.0, "slope"), (120.0, "wind"), (121.5, "squirt")):
            watch("trying", (effect,), SearchOutlook(("slope",), 2, 8))
    assert isinstance(console.file, StringIO)
    assert console.file.getvalue().splitlines() == [
        "table-01: trying: slope (best so far: slope; about 44 s left)",
        "table-01: trying: squirt (best so far: slope; about 86 s left)",
    ]


@pytest.mark.parametrize("terminal", [True, False])
def test_the_first_minute_is_explained_once_also_without_a_terminal(
    terminal: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def add_one(x: float) -> float:
        return x + 1

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    add_one.__module__ = "models.add_one"  # compiled code of this package is kept on disk
    cached = compile_kernel(add_one)
    console = Console(file=StringIO(), force_terminal=terminal, width=100)
    with show_search_progress(console):
        compile_each_time(1.0)
        assert isinstance(console.file, StringIO)
        assert COMPILING_NOTE not in console.file.getvalue(), "every process compiles this"
        cached(1.0)
        cached(1)
    assert console.file.getvalue().count(COMPILING_NOTE) == 1
