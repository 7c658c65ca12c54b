"""`trueroll run` prints every event with its probability, and marks those that are not decided."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_run as shot

from pipeline.chain import FinishedRun
from pipeline.cli.commands.run_command import _print_answer


def test_undecided_events_are_marked(capsys: pytest.CaptureFixture[str]) -> None:
    fit = shot.make_fit(np.linspace(0, 0.8, 25))
    events = replace(fit.events, probability=np.array([0.97, 0.61]))
    _print_answer(FinishedRun(Path("out"), fit.trust, events))
    struck, cushion = (line for line in capsys.readouterr().out.splitlines() if " ms " in line)
    assert struck.rstrip().endswith("97 %")
    assert cushion.rstrip().endswith("61 % (undecided)")
