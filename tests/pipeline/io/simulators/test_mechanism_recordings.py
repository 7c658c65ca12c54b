"""Recordings of mechanisms: columns are found by their names, and what does not fit is refused in a sentence."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from models.estimation.gap_scenes.outside_simulator import Joint
from pipeline.io.simulators.function_simulator import read_function
from pipeline.io.simulators.mechanism_recordings import read_mechanism_shots

PENDULUM = """<mujoco><option timestep="0.002"/><worldbody><body>
<joint name="hinge" type="hinge" axis="0 1 0" range="-2 2" limited="true" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="5"/></actuator></mujoco>"""
FUNCTION = "import numpy as np\n\ndef swing(state, inputs, dt):\n    {}\n"
GOOD = "q, v = state\n    v = v - dt * 9.81 * np.sin(q)\n    return np.array([q + dt * v, v])"
MATH = "q, v = state\n    v = v - dt * 9.81 * float(np.sin(q))\n    return [q + dt * v, v]"


@pytest.fixture
def simulator(tmp_path: Path) -> str:
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    (tmp_path / "arm.xml").write_text(PENDULUM)
    return str(tmp_path / "arm.xml")


def write(folder: Path, header: str, rows: list[list[float | str]], name: str = "real.csv") -> list[Path]:
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    (folder / name).write_text("\n".join(lines) + "\n")
    return [folder / name]


def swing_rows(count: int = 20) -> list[list[float | str]]:
    return [[0.01 * k, round(0.1 * np.cos(0.1 * k), 5), 0.0] for k in range(count)]


@pytest.mark.parametrize("header", ["t,hinge,servo", "time (s),Hinge,Servo", "t,q,command", "t,q0,u0"])
def test_columns_are_found_by_name_or_by_order(tmp_path: Path, simulator: str, header: str):
    shots = read_mechanism_shots(write(tmp_path, header, swing_rows()), simulator)
    assert shots.recordings[0].bodies == ("hinge",)
    np.testing.assert_allclose(shots.recordings[0].positions[:, 0, 0], [row[1] for row in swing_rows()])
    assert shots.histories[0].values.shape == (20, 1)
    assert any("q" in note for note in shots.notes) == ("hinge" not in header.lower())


@pytest.mark.parametrize(("name", "order"), [("command", [2.0, 1.0]), ("ctrl", [1.0, 2.0])])
def test_numbered_commands_are_of_the_joints_of_the_same_number(tmp_path: Path, name: str, order: list[float]):
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    body = PENDULUM.split("<worldbody>")[1].split("</worldbody>")[0]
    motors = '<motor name="b" joint="other"/><motor name="a" joint="hinge"/>'
    bodies = body + body.replace("hinge", "other", 1)
    model = f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    (tmp_path / "two.xml").write_text(model)
    rows = [[*row[:2], 0.0, 1.0, 2.0] for row in swing_rows()]
    shots = read_mechanism_shots(write(tmp_path, f"t,q0,q1,{name}0,{name}1", rows), str(tmp_path / "two.xml"))
    assert shots.simulator.inputs == ("b", "a")
    assert shots.histories[0].values[0].tolist() == order, "in the order of the simulator"


@pytest.mark.parametrize(
    ("position", "command"),
    [("shoulder_pos", "shoulder_cmd"), ("shoulder", "shoulder_target_position"), ("q_shoulder_actual", "ref_shoulder")],
)
def test_columns_with_other_words_beside_the_name_of_a_joint_are_found_and_named_in_notes(
    tmp_path: Path, simulator: str, position: str, command: str
):
    (tmp_path / "arm.xml").write_text(PENDULUM.replace("hinge", "shoulder_joint").replace('type="shoulder_joint"', ""))
    rows = [[1, *row[:2], 9.0, 0.05] for row in swing_rows()]
    shots = read_mechanism_shots(write(tmp_path, f"run,t,{position},shoulder_vel,{command}", rows), simulator)
    assert shots.recordings[0].bodies == ("shoulder_joint",)
    np.testing.assert_allclose(shots.recordings[0].positions[:, 0, 0], [row[1] for row in swing_rows()])
    np.testing.assert_allclose(shots.histories[0].values, 0.05)
    notes = " ".join(shots.notes)
    assert f"{position} is shoulder_joint" in notes
    assert f"the input servo is {command}" in notes
    assert "not used: shoulder_vel" in notes


def test_degrees_are_converted_where_the_header_states_them(tmp_path: Path, simulator: str):
    rows = [[row[0], 90.0, 0.0] for row in swing_rows()]
    shots = read_mechanism_shots(write(tmp_path, "t,hinge (deg),servo", rows), simulator)
    np.testing.assert_allclose(shots.recordings[0].positions, np.pi / 2)


def test_episodes_are_shots_and_empty_inputs_mean_no_power(tmp_path: Path, simulator: str):
    rows = [[k // 10, 0.01 * (k % 10), 0.0, "" if k % 10 > 4 else 0.1] for k in range(20)]
    shots = read_mechanism_shots(write(tmp_path, "episode,t,q,command", rows), simulator)
    assert [one.shot for one in shots.recordings] == [0, 1]
    assert np.isnan(shots.histories[1].values[:, 0]).tolist() == [False] * 5 + [True] * 5
    assert shots.origins[1] == "real.csv, shot 1"


def test_damping_that_a_file_states_is_a_coefficient(tmp_path: Path, simulator: str):
    own = read_mechanism_shots(write(tmp_path, "t,hinge,servo", swing_rows()), simulator).simulator.own_effects
    assert own["joint_friction"] == (0.0, 0.1)
    assert own["armature"] == (0.0,)


def refuse(paths: list[Path], simulator: str) -> str:
    with pytest.raises(OptionError) as refused:
        read_mechanism_shots(paths, simulator)
    message = str(refused.value)
    assert "\n" not in message
    assert "Traceback" not in message
    return message


def test_a_column_without_a_joint_is_refused_with_the_joints(tmp_path: Path, simulator: str):
    message = refuse(write(tmp_path, "t,knee,servo", swing_rows()), simulator)
    assert "knee" in message
    assert "hinge" in message


def test_degrees_that_nobody_states_are_refused_where_the_joint_has_stops(tmp_path: Path, simulator: str):
    rows = [[row[0], 90.0, 0.0] for row in swing_rows()]
    assert "hinge (deg)" in refuse(write(tmp_path, "t,hinge,servo", rows), simulator)


def test_degrees_of_a_joint_without_stops_are_doubted_in_a_note(tmp_path: Path, simulator: str):
    (tmp_path / "free.xml").write_text(PENDULUM.replace('range="-2 2" limited="true"', ""))
    rows = [[row[0], 40.0, 0.0] for row in swing_rows()]
    doubt = "name the column hinge (deg)"
    for header, is_doubted in (("t,hinge,servo", True), ("t,hinge (deg),servo", False)):
        shots = read_mechanism_shots(write(tmp_path, header, rows), str(tmp_path / "free.xml"))
        assert any(doubt in note for note in shots.notes) == is_doubted


@pytest.mark.parametrize("header", ["t,hinge,servo", "t,hinge (deg),servo", "t,q,u"])
@pytest.mark.parametrize("column", [1, 2])
def test_a_text_among_positions_or_inputs_is_refused_with_its_column(
    tmp_path: Path, simulator: str, header: str, column: int
):
    rows = swing_rows()
    rows[5][column] = "broken"
    message = refuse(write(tmp_path, header, rows), simulator)
    assert header.split(",")[column].replace(" ", "_") in message
    assert "no numbers" in message


@pytest.mark.parametrize(
    "rows",
    [swing_rows(1), swing_rows(15), *([[row[0], value, 0.0] for row in swing_rows()] for value in ("nan", "inf", ""))],
)
def test_a_joint_that_was_hardly_observed_is_refused(tmp_path: Path, simulator: str, rows: list[list[float | str]]):
    assert "too few" in refuse(write(tmp_path, "t,hinge,servo", rows), simulator)
    read_mechanism_shots(write(tmp_path, "t,hinge,servo", swing_rows(16)), simulator)


def test_time_that_goes_back_is_refused_with_its_place(tmp_path: Path, simulator: str):
    rows = swing_rows()
    rows[7], rows[8] = rows[8], rows[7]
    assert "t goes back" in refuse(write(tmp_path, "t,hinge,servo", rows), simulator)


def test_a_malformed_file_of_a_simulator_is_refused(tmp_path: Path, simulator: str):
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody><body></mujoco>")
    (tmp_path / "stopped.xml").write_text(PENDULUM.replace("0.002", "0"))
    (tmp_path / "still.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    paths = write(tmp_path, "t,hinge,servo", swing_rows())
    assert "MuJoCo cannot read" in refuse(paths, str(tmp_path / "bad.xml"))
    assert "time step of 0 s" in refuse(paths, str(tmp_path / "stopped.xml"))
    assert "no joint" in refuse(paths, str(tmp_path / "still.xml"))
    assert "there is no" in refuse(paths, str(tmp_path / "none.xml"))
    assert "--simulator takes" in refuse(paths, "pybullet")


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ("return state[:1]", "2 numbers"),
        ("raise KeyError('two\\nlines')", "KeyError: 'two"),
        ("exit(3)", "Exit: 3"),
        ("return np.nan * state", "it went to [nan nan]"),
        (GOOD, ""),
        (MATH, ""),
    ],
)
def test_a_function_is_tried_before_it_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, part: str, request: pytest.FixtureRequest
):
    module = f"swing_{request.node.callspec.indices['body']}"
    (tmp_path / f"{module}.py").write_text(FUNCTION.format(body))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    paths = write(tmp_path, "t,q,u", swing_rows())
    if part:
        assert part in refuse(paths, f"{module}:swing")
    else:
        shots = read_mechanism_shots(paths, f"{module}:swing")
        assert shots.recordings[0].bodies == ("q",)
        assert any("takes one state at a time" in note for note in shots.notes) == (body == MATH)
    assert "cannot be imported" in refuse(paths, f"{module}:nothing")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("raise SystemExit('bye')", "SystemExit: bye"), ("1 / 0", "ZeroDivisionError"), ("def step(:", "SyntaxError"),
        ("step = 3", "is a int"), ("def step(s, i, dt): return s\nstep.coordinates = 3", "coordinates is a tuple"),
        ("def step(s, i, dt): return s\nstep.time_step = float('inf')", "time_step is a number"),
        ("def step(s, i, dt): return s\nstep.velocity_lag = 0.01", "velocity_lag is a number"),
    ],
)  # fmt: skip
def test_a_module_that_cannot_be_used_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, part: str, request: pytest.FixtureRequest
):
    module = f"unusable_{request.node.callspec.indices['text']}"
    (tmp_path / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert part in refuse(write(tmp_path, "t,q,u", swing_rows()), f"{module}:step")


def test_a_function_states_how_far_its_velocities_lag_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = "def step(s, i, dt): return s\nstep.time_step, step.velocity_lag = 0.004, 0.002"
    text += "\nstep.coordinates, step.units = ('x', 'y'), 'm'"
    (tmp_path / "lagging.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    simulator = read_function("lagging:step", (Joint("q", "rad"),))
    assert pickle.loads(pickle.dumps(simulator)).velocity_lag == simulator.velocity_lag == 0.002
    assert simulator.halve_step().velocity_lag == 0.001
    assert [one.unit for one in simulator.joints] == ["m", "m"], "one unit is that of all"


def test_a_recorded_simulation_is_read_as_a_simulator(tmp_path: Path):
    simulated = write(tmp_path, "t,q", [row[:2] for row in swing_rows()], "simulated.csv")
    shots = read_mechanism_shots(write(tmp_path, "t,q", [row[:2] for row in swing_rows()]), str(simulated[0]))
    assert shots.simulator.joints[0].name == "q"


def test_an_actuator_that_is_called_like_its_joint_has_a_column_of_its_own(tmp_path: Path, simulator: str):
    (tmp_path / "same.xml").write_text(
        PENDULUM.replace('position name="servo"', 'motor name="hinge"').replace('kp="5"', "")
    )
    rows = [[*row[:2], 0.3] for row in swing_rows()]
    shots = read_mechanism_shots(write(tmp_path, "t,hinge,hinge_command", rows), str(tmp_path / "same.xml"))
    np.testing.assert_allclose(shots.histories[0].values, 0.3)


def test_an_input_without_a_column_is_named_in_a_note(tmp_path: Path, simulator: str):
    shots = read_mechanism_shots(write(tmp_path, "t,hinge,other", swing_rows()), simulator)
    notes = " ".join(shots.notes)
    assert "no column for servo: taken for 0" in notes
    assert "not used: other" in notes
    assert "same name" not in notes
    swapped = read_mechanism_shots(write(tmp_path, "t,hinge,sevro", swing_rows()), simulator)
    assert any("servo has no column; if it is sevro, give both the same name" in note for note in swapped.notes)


@pytest.mark.parametrize(("column", "is_doubted"), [("othr", True), ("other_vel", False), ("load", False)])
def test_a_column_that_is_nearly_called_like_a_joint_without_one_is_doubted(
    tmp_path: Path, simulator: str, column: str, is_doubted: bool
):
    body = PENDULUM.split("<worldbody>")[1].split("</worldbody>")[0]
    model = PENDULUM.replace("</worldbody>", body.replace("hinge", "other", 1) + "</worldbody>")
    (tmp_path / "two.xml").write_text(model)
    rows = [[*row, 0.3] for row in swing_rows()]
    shots = read_mechanism_shots(write(tmp_path, f"t,hinge,servo,{column}", rows), str(tmp_path / "two.xml"))
    doubts = [note for note in shots.notes if "give both the same name" in note]
    assert len(doubts) == is_doubted
    assert all("other has no column; if it is othr" in note for note in doubts)


def test_a_servo_takes_degrees_where_the_header_states_them(tmp_path: Path, simulator: str):
    rows = [[*row[:2], 90.0] for row in swing_rows()]
    shots = read_mechanism_shots(write(tmp_path, "t,hinge,servo (deg)", rows), simulator)
    np.testing.assert_allclose(shots.histories[0].values, np.pi / 2)


def test_a_run_of_mujoco_that_diverges_is_lost(tmp_path: Path, simulator: str):
    shots = read_mechanism_shots(write(tmp_path, "t,hinge,servo", swing_rows()), simulator)
    start = np.zeros((2, 2))
    runs = shots.simulator.begin(start, [{}, {}], np.ones((2, 1), bool), np.zeros(2, int), np.zeros(2))
    path = runs.advance(np.zeros((2, 10, 1)), np.array([[1e14], [0.0]]))
    assert np.isnan(path[0, -1]).all()
    assert np.isfinite(path[1]).all()


def test_a_shot_that_was_not_simulated_is_refused(tmp_path: Path):
    real = write(tmp_path, "shot,t,q", [[shot, *row[:2]] for shot in (0, 1) for row in swing_rows()])
    simulated = write(tmp_path, "shot,t,q", [[0, *row[:2]] for row in swing_rows()], "simulated.csv")
    assert "lacks shot 1" in refuse(real, str(simulated[0]))


def test_simulators_reach_another_process(tmp_path: Path, simulator: str, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "swing_again.py").write_text(FUNCTION.format(GOOD))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    simulated = write(tmp_path, "t,q", [row[:2] for row in swing_rows()], "simulated.csv")
    for name, header in ((simulator, "t,hinge,servo"), ("swing_again:swing", "t,q,u"), (str(simulated[0]), "t,q,u")):
        one = read_mechanism_shots(write(tmp_path, header, swing_rows()), name).simulator
        other = pickle.loads(pickle.dumps(one))
        assert [joint.name for joint in other.joints] == [joint.name for joint in one.joints]
        inputs, powered = np.zeros((1, 5, len(one.inputs))), np.ones((1, len(one.inputs)), bool)
        paths = [
            each.begin(np.array([[0.1, 0.0]]), [{}], powered, np.zeros(1, int), np.zeros(1)).advance(
                inputs, np.zeros((1, 1))
            )
            for each in (one, other)
        ]
        np.testing.assert_array_equal(*paths)


def test_a_long_recording_is_cut_into_shots_that_keep_what_was_asked_before(tmp_path: Path, simulator: str):
    shots = read_mechanism_shots(write(tmp_path, "t,q,command", swing_rows(400)), simulator)
    assert [len(one.t) for one in shots.recordings] == [100] * 4
    assert [one.shot for one in shots.recordings] == list(shots.histories) == list(range(4))
    assert shots.recordings[3].t[0] == pytest.approx(3.0)
    assert shots.histories[3].t[0] == 0.0
    assert shots.origins[3] == "real.csv, shot 0, 3.00 to 3.99 s"
    assert any("cut into 4 pieces" in note for note in shots.notes)


def test_two_runs_are_cut_and_named_by_run_and_time(tmp_path: Path, simulator: str):
    rows = [[run, *row] for run in (3, 5) for row in swing_rows(200)]
    shots = read_mechanism_shots(write(tmp_path, "shot,t,q,command", rows), simulator)
    assert [origin.partition(", ")[2][:6] for origin in shots.origins.values()] == ["shot 3"] * 2 + ["shot 5"] * 2
    assert shots.run_count == 2, "runs at the same times are still two"


def test_a_fast_log_is_not_cut_below_the_length_of_a_prediction(tmp_path: Path, simulator: str):
    rows = [[row[0] / 10, *row[1:]] for row in swing_rows(1300)]
    assert len(read_mechanism_shots(write(tmp_path, "t,q,command", rows), simulator).recordings) == 1


def test_a_recording_that_is_cut_meets_its_own_simulation_in_every_shot(tmp_path: Path):
    simulated = write(tmp_path, "t,q", [row[:2] for row in swing_rows(400)], "simulated.csv")
    shots = read_mechanism_shots(write(tmp_path, "t,q", [row[:2] for row in swing_rows(400)]), str(simulated[0]))
    last = shots.recordings[-1]
    path = shots.simulator.read_path(last.shot, last.t)  # type: ignore[attr-defined]
    np.testing.assert_allclose(path[:, 0], last.positions[:, 0, 0], atol=1e-9)


def test_many_shots_are_not_cut(tmp_path: Path, simulator: str):
    rows = [[shot, *row] for shot in range(6) for row in swing_rows(200)]
    assert len(read_mechanism_shots(write(tmp_path, "shot,t,q,command", rows), simulator).recordings) == 6


def test_jumps_of_a_whole_turn_are_undone_where_a_joint_turns_freely(tmp_path: Path):
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    (tmp_path / "wheel.xml").write_text(PENDULUM.replace('range="-2 2" limited="true"', ""))
    angles = 0.3 * np.arange(60)
    rows = [[0.01 * k, float((one + np.pi) % (2 * np.pi) - np.pi)] for k, one in enumerate(angles)]
    rows[30][1] = ""  # a gap is no jump
    shots = read_mechanism_shots(write(tmp_path, "t,hinge", rows), str(tmp_path / "wheel.xml"))
    angles[30] = np.nan
    np.testing.assert_allclose(shots.recordings[0].positions[:, 0, 0], angles, atol=1e-9)
    assert any("jumps of a whole turn were undone in hinge" in one for one in shots.notes)
    tame = read_mechanism_shots(
        write(tmp_path, "t,hinge", [row[:2] for row in swing_rows()]), str(tmp_path / "wheel.xml")
    )
    assert not any("were undone" in one for one in tame.notes)


@pytest.mark.parametrize("has_place", [True, False])
def test_turns_beyond_half_a_turn_are_not_compared(tmp_path: Path, has_place: bool):
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    body = '<body name="disc"><freejoint/><geom type="box" size="0.1 0.1 0.02"/></body>'
    (tmp_path / "disc.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    rows = [[0.01 * k, 0.1 * k, 0.0, 0.0, 0.0, 0.0, (0.3 * k + np.pi) % (2 * np.pi) - np.pi] for k in range(40)]
    names = ["disc.x", "disc.y", "disc.z", "disc.rx", "disc.ry", "disc.rz"]
    if not has_place:
        rows, names = [[row[0], *row[4:]] for row in rows], names[3:]
    real = write(tmp_path, ",".join(["t", *names]), rows)
    if not has_place:
        with pytest.raises(OptionError, match=r"disc.rx, disc.ry, disc.rz go beyond half a turn.*record shorter runs"):
            read_mechanism_shots(real, str(tmp_path / "disc.xml"))
        return
    shots = read_mechanism_shots(real, str(tmp_path / "disc.xml"))
    assert shots.recordings[0].bodies == ("disc.x", "disc.y", "disc.z")
    assert any(one.endswith("not used: disc.rx, disc.ry, disc.rz") for one in shots.notes)
