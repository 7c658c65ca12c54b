"""Tables on standard output, wide and narrow."""

from __future__ import annotations

import pytest
from rich.console import Console

from pipeline.terminal import command_line

ROW = ("1.25 s", "in (99.6 %)", "48 cm inside the outer edge of the right end line")


@pytest.mark.parametrize(("width", "expected"), [(80, ROW), (60, ROW[:2])])
def test_a_narrow_screen_shows_the_columns_for_which_it_has_room(
    width: int, expected: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command_line, "make_output_console", lambda: Console(width=width))
    command_line.print_rows(("time", "landing", "place"), [ROW], (0, 1))
    shown = capsys.readouterr().out.splitlines()[1]
    assert "  ".join(expected) == shown.rstrip()
