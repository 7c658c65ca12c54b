"""Diagnosis of simulators from outside: what is withheld is named, and a wrong coefficient is no missing effect."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.pseudo_terminal import Terminal, make_terminal

import trueroll
from pipeline.reporting.text.gap_sentences import format_verdict
from pipeline.simulator_diagnosis import diagnose_mechanism

terminal = pytest.fixture(make_terminal)
pytestmark = pytest.mark.slow

SWING = """
import numpy as np

def swing(state, inputs, dt):
    q, v = state
    half = v - dt / 2 * 20.0 * np.sin(q)
    q = q + dt * half
    return np.array([q, half - dt / 2 * 20.0 * np.sin(q)])

swing.coordinates = ("q",)
"""
ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="hinge" type="hinge" axis="0 1 0" damping="{}"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.5"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


def write_swings(path: Path, viscous: float, seconds: float = 1.2) -> None:
    """Write six swings of a pendulum with viscous friction, at 50 Hz with noise of 1 mrad, as CSV or MCAP."""
    rng, rows = np.random.default_rng(1), []
    t = np.arange(round(50 * seconds)) / 50
    for shot in range(6):
        start = [rng.uniform(0.5, 1.2), rng.uniform(-1, 1)]
        solution = solve_ivp(
            lambda _, y: [y[1], -20.0 * np.sin(y[0]) - viscous * y[1]],
            (0, seconds),
            start,
            t_eval=t,
            rtol=1e-9,
            atol=1e-9,
        )
        noisy = solution.y[0] + 1e-3 * rng.standard_normal(len(t))
        rows += [(shot, round(x, 2), round(q, 6)) for x, q in zip(t.tolist(), noisy.tolist(), strict=True)]
    if path.suffix == ".csv":
        path.write_text("\n".join(("shot,t,q", *(f"{shot},{x},{q}" for shot, x, q in rows))) + "\n")
        return
    from support.ros_bags import joint_state, write_bag

    write_bag(path, [joint_state(round(1e9 * (5 * shot + x)), ("q",), [q]) for shot, x, q in rows])


@pytest.mark.parametrize("name", ["real.csv", "real.mcap"])
def test_friction_that_a_function_lacks_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, terminal: Terminal, name: str
):
    if name == "real.mcap":
        pytest.importorskip("mcap_ros2", reason="the extra simulators is not installed")
    (tmp_path / "swing_model.py").write_text(SWING)
    write_swings(tmp_path / name, 0.3)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    done = terminal("diagnose", name, "--simulator", "swing_model:swing", "-o", "gap")
    assert done.status == 0
    assert "Your simulator lacks joint friction." in done.out
    gap = json.loads((tmp_path / "gap" / "gap.json").read_text())
    viscous = gap["fitted"]["joint_friction.viscous"]
    assert viscous["value"] == pytest.approx(0.3, abs=max(3 * viscous["sigma"], 0.01))
    assert gap["gap"]["metric"] == "rms_rad"
    assert gap["where"][0]["joint"] in (None, "q")
    assert (tmp_path / "gap" / "gap.html").stat().st_size > 1000
    assert "trueroll view gap" in done.out
    assert (tmp_path / "gap" / "recording.rrd").stat().st_size > 1000


def test_a_wrong_coefficient_of_a_file_is_reported_and_is_no_missing_effect(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco", reason="mujoco is an extra")
    truth = mujoco.MjModel.from_xml_string(ARM.format(0.02))
    rng, lines = np.random.default_rng(2), ["shot,t,hinge,motor"]
    for shot in range(6):
        data = mujoco.MjData(truth)
        data.qpos[0], rate = rng.uniform(-1, 1), rng.uniform(2, 8)
        for row in range(80):
            push = 0.3 * np.sin(rate * row / 50)
            lines.append(f"{shot},{row / 50:.2f},{data.qpos[0] + 1e-3 * rng.standard_normal():.6f},{push:.6f}")
            data.ctrl[0] = push
            for _ in range(10):
                mujoco.mj_step(truth, data)
    (tmp_path / "real.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "arm.xml").write_text(ARM.format(0.05))
    report = diagnose_mechanism([tmp_path / "real.csv"], str(tmp_path / "arm.xml"))[0]
    assert report.verdict == "none"
    note = next(note for note in report.notes if note.startswith("your "))
    assert "viscous is 0.05" in note
    assert report.gap.as_stated > 3 * report.gap.closure.before
    assert "Coefficients of your simulator are wrong: with them, its rms error is" in format_verdict(report)
    assert any(note.startswith('in the file of your simulator, give joint hinge damping="0.0') for note in report.notes)
    fitted = {one.name: one for one in report.fitted}["joint_friction.viscous"]
    assert fitted.value == pytest.approx(0.02, abs=4 * fitted.sigma)
    assert fitted.sigma < 0.001


SERVO = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="hinge" type="hinge" axis="0 1 0" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.3"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="40" kv="1" forcerange="-4 4"/></actuator></mujoco>"""


def test_a_motor_that_loses_force_with_its_speed_is_told_from_friction_by_what_it_does_without_power(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco", reason="mujoco is an extra")
    truth = mujoco.MjModel.from_xml_string(SERVO)
    rng, lines, fastest = np.random.default_rng(4), ["shot,t,hinge,servo"], 3.0
    for shot in range(8):
        data, period, size = mujoco.MjData(truth), rng.uniform(0.4, 0.8), rng.uniform(0.4, 1.0)
        for row in range(90):
            has_power = row < 50
            asked = size * (1 if row / 50 % period < period / 2 else -1)
            told = f"{asked:.6f}" if has_power else ""
            lines.append(f"{shot},{row / 50:.2f},{data.qpos[0] + 1e-3 * rng.standard_normal():.6f},{told}")
            data.ctrl[0] = asked
            if not has_power:
                truth.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
            for _ in range(10):
                data.qfrc_applied[0] = -4.0 * data.qvel[0] / fastest if has_power else 0.0
                mujoco.mj_step(truth, data)
        truth.opt.disableflags = 0
    (tmp_path / "real.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "servo.xml").write_text(SERVO)
    report = diagnose_mechanism([tmp_path / "real.csv"], str(tmp_path / "servo.xml"))[0]
    assert report.effects == ("actuator_gain",)
    assert report.gap.closure.closed > 0.95
    fitted = {one.name: one for one in report.fitted}
    assert fitted["actuator_gain.fall"].value == pytest.approx(1 / fastest, rel=0.1)
    assert fitted["actuator_gain.limit"].value == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(
    ("viscous", "is_explicit", "step", "is_doubted"),
    [(0.0, True, 5, True), (0.3, False, 5, False), (0.3, True, 5, True), (0.3, True, 2.5, False)],
)
def test_a_step_that_is_too_long_is_doubted_before_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, viscous: float, is_explicit: bool, step: float, is_doubted: bool
):
    """Explicit steps of Euler drive a pendulum, the longer the more; friction is no error of a step.

    Beside it, half of 5 ms explains 12 % of the misfit, half of 2.5 ms 7 %.
    """
    lines, euler = SWING.splitlines(), "    return np.array([q + dt * v, v - dt * 20.0 * np.sin(q)])"
    name = f"steps_{'explicit' if is_explicit else 'verlet'}_{10 * viscous:.0f}_{10 * step:.0f}"
    model = [*lines[:5], euler, *lines[8:]] if is_explicit else lines
    (tmp_path / f"{name}.py").write_text("\n".join([*model, f"swing.time_step = {step / 1e3}"]) + "\n")
    write_swings(tmp_path / "real.csv", viscous)
    monkeypatch.syspath_prepend(str(tmp_path))
    told: list[str] = []

    def stop(*_: object) -> None:
        raise RuntimeError("the search begins")

    monkeypatch.setattr("pipeline.simulator_diagnosis.diagnose", stop)
    with pytest.raises(RuntimeError, match="search"):
        diagnose_mechanism([tmp_path / "real.csv"], f"{name}:swing", on_note=told.append)
    assert any("give it a shorter time_step first" in note for note in told) == is_doubted


def test_a_report_states_how_much_of_a_long_log_was_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "swing_model.py").write_text(SWING)
    write_swings(tmp_path / "real.csv", 0.3, 3.0)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    whole = diagnose_mechanism([tmp_path / "real.csv"], "swing_model:swing")[0]
    assert not any("windows of the log" in note for note in whole.notes)
    monkeypatch.setattr("diagnosis.selection.study.ENOUGH_WINDOWS", 5)
    thinned = diagnose_mechanism([tmp_path / "real.csv"], "swing_model:swing")[0]
    note = next(note for note in thinned.notes if "windows of the log" in note)
    used, all_windows = (int(word) for word in note.split() if word.isdigit())
    assert 0 < used < all_windows


def test_python_takes_a_simulator_too(tmp_path: Path):
    write_swings(tmp_path / "real.csv", 0.0)
    with pytest.raises(trueroll.TruerollError, match="--simulator takes"):
        trueroll.diagnose(tmp_path / "real.csv", simulator="nothing")
