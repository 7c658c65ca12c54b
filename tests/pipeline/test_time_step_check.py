"""Half the step of a function is tried only where runs suffice, on what a search uses of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.fitting.diagnosis_windows import count_windows
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem
from models.core.recording import Recording
from models.numerics.executor import SerialExecutor
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots
from pipeline.simulator_diagnosis import diagnose_mechanism

SWING = """
import numpy as np

def swing(state, inputs, dt):
    q, v = state
    v = v - dt * 25.0 * q
    return np.array([q + dt * v, v])

swing.coordinates = ("q",)
"""


@pytest.fixture
def swing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A pendulum as a function that can be imported."""
    (tmp_path / "stepped_swing.py").write_text(SWING)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "stepped_swing:swing"


def write_swings(path: Path, shots: int, rows: int) -> Path:
    """Write swings at 50 Hz."""
    lines = [f"{shot},{x / 50},{np.sin(x / 10 + shot):.4f}" for shot in range(shots) for x in range(rows)]
    path.write_text("\n".join(["shot,t,q", *lines]) + "\n")
    return path


def test_too_few_rows_are_undecidable_for_a_function_too(tmp_path: Path, swing: str):
    report = diagnose_mechanism([write_swings(tmp_path / "real.csv", 4, 6)], swing)[0]
    assert report.verdict == "undecidable"
    assert "too few" in report.reason


def test_assumptions_are_told_before_half_the_step_is_tried_on_what_a_search_uses(
    tmp_path: Path, swing: str, monkeypatch: pytest.MonkeyPatch
):
    told: list[str] = []
    executor, read = SerialExecutor(), read_mechanism_shots
    monkeypatch.setattr(
        "pipeline.simulator_diagnosis.read_mechanism_shots", lambda *given: replace(read(*given), notes=("assumed",))
    )

    def fit(problem: DiagnosisProblem, used: tuple[Recording, ...]) -> None:
        assert told == ["assumed", "trying half the time step"]
        assert problem.executor is executor
        assert [one.shot for one in used] == [0, 2, 4, 1, 5], "the others are held out"
        assert count_windows(problem, used) == len(used)
        raise RuntimeError("fitting")

    monkeypatch.setattr("pipeline.simulator_diagnosis.fit_initial_windows", fit)
    monkeypatch.setattr("pipeline.simulator_diagnosis.ENOUGH_WINDOWS", 4)
    with pytest.raises(RuntimeError, match="fitting"):
        diagnose_mechanism(
            [write_swings(tmp_path / "real.csv", 6, 150)],
            swing,
            0,
            lambda doing, *_: told.append(doing),
            executor,
            told.append,
        )
