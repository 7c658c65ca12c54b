"""A diagnosis of a mechanism shows predictions over the motion, and where they are wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader
from support.diagnosis_reports import NOTHING_UNEXPLAINED

from diagnosis.fitting.gap_closure import GapClosure
from diagnosis.fitting.prediction_windows import PredictionWindow
from diagnosis.verdicts.verdict import DiagnosisReport, Gap
from models.core.recording import Recording
from models.estimation.gap_scenes.mechanism_inputs import InputHistory
from models.estimation.gap_scenes.simulator_scene import find_reversals
from pipeline.io.simulators.mechanism_recordings import MechanismShots, read_mechanism_shots
from pipeline.reporting.pages.gap_page import build_gap_figures
from pipeline.reporting.recording.gap_recording import write_gap_recording

ARM = """<mujoco><worldbody><geom type="box" size=".1 .1 .01"/><body><joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02"/><body name="my hand/1" pos="0 0 -.4">
<joint name="elbow" axis="0 1 0"/><geom type="sphere" pos="0 0 -.3" size=".05"/></body></body></worldbody>
<actuator><motor name="m" joint="elbow"/></actuator></mujoco>"""


@pytest.fixture
def shots(tmp_path: Path) -> MechanismShots:
    """Two swings of an arm with two joints; the input of the elbow rises."""
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    (tmp_path / "arm.xml").write_text(ARM)
    lines = [f"{shot},{0.02 * k:.2f},{np.sin(0.1 * k):.5f},0.5,{k}" for shot in range(2) for k in range(60)]
    (tmp_path / "real.csv").write_text("\n".join(["shot,t,shoulder,elbow,m", *lines]) + "\n")
    return read_mechanism_shots([tmp_path / "real.csv"], str(tmp_path / "arm.xml"))


def diagnosis_of(recordings: tuple[Recording, ...]) -> DiagnosisReport:
    """Return a diagnosis whose predictions of the elbow err by 20 mrad times s, and afterwards by a tenth of it."""
    windows = tuple(PredictionWindow(one, 1) for one in recordings)
    off = [np.multiply.outer(one.t, np.linspace(0, 0.02, len(one.bodies)))[:, :, None] for one in recordings]
    before, after = (
        tuple(one.positions + part * x for one, x in zip(recordings, off, strict=True)) for part in (1.0, 0.1)
    )
    closure = GapClosure(0.02, 0.002, 0.001, 0.99, (0.9, 1.0), True)
    gap = Gap("rms_rad", 1.2, (0, 1), closure, windows, before, after, coordinates=("q",))
    return DiagnosisReport(
        "mechanism", (), "effects", ("delay",), (), (), gap, (), NOTHING_UNEXPLAINED, (), (), (), (), "", 0.0, ()
    )


def read_columns(path: Path) -> dict[str, int]:
    """Return the number of rows of each entity."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        rows[chunk.entity_path] = max(rows.get(chunk.entity_path, 0), chunk.num_rows)
    return rows


def test_shapes_and_plots_follow_the_recording_and_both_predictions(shots: MechanismShots, tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    write_gap_recording(diagnosis_of(shots.recordings), shots.simulator, path, "arm", shots.origins)
    rows = read_columns(path)
    for kind in ("recorded", "before", "after"):
        assert rows[rf"/world/{kind}/my\ hand\/1/2"] == 120
        assert rows[f"/plots/elbow/{kind}"] == 121, "a break between the two runs"
    assert rows["/world/fixed/world/0"] == 1
    assert rows["/log/runs"] == 2


def test_a_shape_is_where_the_joints_of_its_body_put_it(shots: MechanismShots) -> None:
    simulator = shots.simulator
    shapes = simulator.list_shapes()  # type: ignore[attr-defined]
    assert [one.kind for one in shapes] == ["box", "capsule", "sphere"]
    places, _ = simulator.place_shapes(shapes, np.array([[0.0, 0.0], [np.pi / 2, 0.0]]))  # type: ignore[attr-defined]
    np.testing.assert_allclose(places[:, 2], [[0, 0, -0.7], [-0.7, 0, 0]], atol=1e-9)


def test_windows_that_overlap_are_shown_once_and_nothing_is_added_without_an_effect(
    shots: MechanismShots, tmp_path: Path
) -> None:
    one = shots.recordings[0]
    halves = (one, replace(one.select_rows(30, 60)), shots.recordings[1])
    path = tmp_path / "recording.rrd"
    write_gap_recording(replace(diagnosis_of(halves), verdict="none"), shots.simulator, path, "arm", {})
    rows = read_columns(path)
    assert rows["/log/runs"] == 2
    assert not any(one.startswith("/world/after") for one in rows)
    nothing = replace(diagnosis_of(halves), gap=Gap("rms_rad", 1.0))
    write_gap_recording(nothing, shots.simulator, path, "arm", {})
    assert not path.exists(), "nothing of an earlier diagnosis is left"


def test_errors_are_drawn_by_joint_phase_and_what_the_joint_does(shots: MechanismShots) -> None:
    (first, joints), (second, figure) = build_gap_figures(diagnosis_of(shots.recordings).gap, shots=shots)[:2]
    assert first == "Which joints are predicted wrongly"
    assert joints.data[0].x == ("shoulder", "elbow")
    np.testing.assert_allclose(joints.data[0].y, [0.0, 20 * np.sqrt(np.mean(np.square(0.02 * np.arange(1, 60))))])
    assert second == "Where predictions of elbow are wrong"
    panels = [one.text for one in figure.layout.annotations]
    assert panels == ["phase", "speed (rad/s)", "position (rad)", "time in the run (s)", "input"]
    time, given = figure.data[3:5]
    np.testing.assert_allclose(time.y, 20 * np.array(time.x), rtol=0.15)
    np.testing.assert_allclose(given.x, np.array(time.x) / 0.02, rtol=1e-6, atol=1e-6)
    after = [one.y for one in figure.data if one.name == "predicted after"][3]
    np.testing.assert_allclose(after, np.array(time.y) / 10)


def test_an_input_is_that_of_the_actuator_of_the_joint_and_holds_until_the_next_row(shots: MechanismShots) -> None:
    sparse = {one.shot: InputHistory(np.array([0.0, 0.6]), np.array([[1.0], [3.0]])) for one in shots.recordings}
    figure = build_gap_figures(diagnosis_of(shots.recordings).gap, shots=replace(shots, histories=sparse))[1][1]
    assert sorted(figure.data[4].x)[:3] == [1.0] * 3
    assert sorted(figure.data[4].x)[-3:] == [3.0] * 3


def test_a_joint_turns_back_a_tenth_of_a_second_around_its_rest() -> None:
    t = np.arange(0, 1, 0.02)
    turns = find_reversals(np.stack([t - 0.51, np.ones_like(t)], axis=1), t)
    assert not turns[:, 1].any()
    assert t[turns[:, 0]].min() == pytest.approx(0.4, abs=0.021)
    assert t[turns[:, 0]].max() == pytest.approx(0.6, abs=0.021)
