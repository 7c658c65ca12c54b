"""Progress of a run in a log."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from pipeline.terminal.progress_display import LINE_INTERVAL_S, StageDisplay


def test_a_log_says_which_stage_is_how_far_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    stream, now = StringIO(), [0.0]
    monkeypatch.setattr("pipeline.terminal.progress_display.time.monotonic", lambda: now[0])
    with StageDisplay(Console(file=stream, force_terminal=False), "clip.mp4") as display:
        for stage, shares in (("read", (0.5,)), ("explain", (0.25, 0.5))):
            update = display.start_stage(stage)
            for share in shares:
                now[0] += LINE_INTERVAL_S - 1
                update(share)
            display.finish_stage(stage, 1.0, cached=False)
    assert stream.getvalue().splitlines() == ["clip.mp4: explain, 25%"]
