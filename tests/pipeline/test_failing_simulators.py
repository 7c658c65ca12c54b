"""Simulators that fail in windows: these windows are left out, and where most of them fail nothing is diagnosed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from models.estimation.gap_scenes.simulator_scene import build_simulator_scene, leave_out_failures
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots
from pipeline.simulator_diagnosis import diagnose_mechanism

# a step from any recorded state is fine, but below the limit the position grows without bound
MODULE = """
import numpy as np

def drift(state, inputs, dt):
    q, v = state
    with np.errstate(over="ignore"):
        return np.array([q * 1e200 if q < {limit} else q + dt * v, v])
"""


def write_drifts(folder: Path, limit: float) -> str:
    """Write eight runs about -2, -1, 1 and 2, and a simulator that keeps the speed and diverges below a limit."""
    rows = ["shot,t,q"]
    for shot, start in enumerate((-2.0, -1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0)):
        rows += [f"{shot},{0.01 * k:.2f},{start + 0.2 * np.sin(0.08 * k):.4f}" for k in range(300)]
    (folder / "real.csv").write_text("\n".join(rows) + "\n")
    module = f"drifting_below_{limit:g}".replace("-", "minus_").replace(".", "_")
    (folder / f"{module}.py").write_text(MODULE.format(limit=limit))
    return f"{module}:drift"


def test_windows_that_a_simulator_cannot_simulate_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    shots = read_mechanism_shots([tmp_path / "real.csv"], write_drifts(tmp_path, -1.5))
    assert not shots.notes, "no single step fails"
    scene = build_simulator_scene(shots.simulator, shots.recordings, shots.histories)
    working, failed, total = leave_out_failures(scene, shots.recordings)
    windows = [scene.split_recording(one) for one in shots.recordings]
    assert total == sum(map(len, windows))
    assert [one.shot for one in working] == [1, 2, 3, 4, 5, 6, 7], "the first run has no other window"
    starts = [one.start for one in scene.build_model(windows[1], ()).windows]
    steep = [k for k, (q, v) in enumerate(starts) if q + v * np.ptp(windows[1][k].t) < -1.5]
    assert 0 < len(steep) < len(windows[1]), "some of those that begin downwards reach the limit"
    assert failed == len(windows[0]) + len(steep)
    lost = np.isin(shots.recordings[1].t, np.concatenate([windows[1][k].t for k in steep]))
    np.testing.assert_array_equal(np.isnan(working[0].positions[:, 0, 0]), lost)
    for one, before in zip(working[1:], shots.recordings[2:], strict=True):
        np.testing.assert_array_equal(one.positions, before.positions)


def test_nothing_is_diagnosed_where_most_windows_fail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    simulator = write_drifts(tmp_path, 2.5)
    with pytest.raises(OptionError, match=r"cannot simulate .. of .. windows.*shorten its time step"):
        diagnose_mechanism([tmp_path / "real.csv"], simulator)
