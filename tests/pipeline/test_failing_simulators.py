"""Simulators that fail in windows: these windows are left out, and where most of them fail nothing is diagnosed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from models.estimation.gap_scenes.simulator_scene import build_simulator_scene, leave_out_failures
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots
from pipeline.simulator_diagnosis import diagnose_mechanism

MODULE = """
import numpy as np

def drift(state, inputs, dt):
    q, v = state
    if q < {limit}:
        {beyond}
    return np.array([q + dt * v, v])
"""
GROWS, RAISES = "q = q * 1e100 if abs(q) < 1e200 else q", "raise RuntimeError('stop\\nreached')"


def write_drifts(folder: Path, limit: float, beyond: str) -> str:
    """Write eight runs about 2, 1, -1 and -2, and a simulator that keeps the speed and fails below a limit."""
    rows = ["shot,t,q"]
    for shot, start in enumerate((2.0, 2.0, 2.0, 2.0, 2.0, 1.0, -1.0, -2.0)):
        rows += [f"{shot},{0.01 * k:.2f},{start + 0.2 * np.sin(0.08 * k):.4f}" for k in range(300)]
    (folder / "real.csv").write_text("\n".join(rows) + "\n")
    module = f"drifting_{beyond[:2].strip()}_{limit:g}".replace("-", "minus_").replace(".", "_")
    (folder / f"{module}.py").write_text(MODULE.format(limit=limit, beyond=beyond))
    return f"{module}:drift"


@pytest.mark.parametrize("beyond", [GROWS, RAISES])
def test_windows_that_a_simulator_cannot_simulate_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beyond: str
):
    monkeypatch.chdir(tmp_path)
    simulator = write_drifts(tmp_path, -1.5, beyond)
    shots = read_mechanism_shots([tmp_path / "real.csv"], simulator)
    scene = build_simulator_scene(shots.simulator, shots.recordings, shots.histories)
    working, failed, total = leave_out_failures(scene, shots.recordings)
    windows = [scene.split_recording(one) for one in shots.recordings]
    assert total == sum(map(len, windows))
    assert [one.shot for one in working] == [0, 1, 2, 3, 4, 5, 6], "the last run has no other window"
    starts = [one.start for one in scene.build_model(windows[6], ()).windows]
    steep = [k for k, (q, v) in enumerate(starts) if q + v * np.ptp(windows[6][k].t) < -1.5]
    assert 0 < len(steep) < len(windows[6]), "some of those that begin downwards reach the limit"
    assert failed == len(windows[7]) + len(steep)
    lost = np.isin(shots.recordings[6].t, np.concatenate([windows[6][k].t for k in steep]))
    np.testing.assert_array_equal(np.isnan(working[6].positions[:, 0, 0]), lost)
    for one, before in zip(working[:6], shots.recordings[:6], strict=True):
        np.testing.assert_array_equal(one.positions, before.positions)


@pytest.mark.parametrize(
    ("beyond", "reason"), [(GROWS, "positions grow without bound"), (RAISES, "RuntimeError: stop reached")]
)
def test_nothing_is_diagnosed_where_most_windows_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beyond: str, reason: str
):
    monkeypatch.chdir(tmp_path)
    simulator = write_drifts(tmp_path, 1.9, beyond)
    with pytest.raises(OptionError, match=rf"fails in .. of 56 windows.*: {reason}; check its time step"):
        diagnose_mechanism([tmp_path / "real.csv"], simulator)
