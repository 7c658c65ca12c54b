"""`trueroll run` prints every event with its probability, and the alternatives of those that are not decided."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_run as shot

from pipeline.chain import FinishedRun
from pipeline.cli.commands.run_command import _print_answer


def test_an_event_is_undecided_where_an_alternative_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    fit = shot.make_unsure_fit(np.linspace(0, 0.8, 25))
    still = fit.events.select_rows(np.array([0, 1, 1]))
    events = replace(still, kind=("strike", "cushion", "rest"), probability=np.array([0.97, 0.61, 0.85]))
    scene = shot.make_scene()
    saved = shot.make_unexplained_shot(shot.make_tracks(shot.write_clip(tmp_path / "clip.mp4"), scene), scene)
    _print_answer(FinishedRun(tmp_path, saved, replace(fit, events=events)))
    struck, cushion, rest = (line.rstrip() for line in capsys.readouterr().out.splitlines() if " ms " in line)
    assert struck.endswith("97 %")
    assert cushion.endswith("undecided: 61 %, or something else 39 %")
    assert rest.endswith(" 85 %")
    assert "undecided" not in rest, "a ball that does not rest yet is no alternative"
