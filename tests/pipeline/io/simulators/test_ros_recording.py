"""Recordings of ROS 2: a bag gives the recordings that the CSV file of the same motion gives."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from models.core.errors import OptionError
from pipeline.io.simulators.mechanism_recordings import MechanismShots, read_mechanism_shots
from pipeline.io.simulators.mujoco_simulator import find_rotation
from pipeline.io.simulators.ros_messages import DEFINITIONS
from pipeline.io.simulators.ros_recording import read_ros_recording

pytest.importorskip("mcap_ros2", reason="the extra simulators is not installed")

from support.ros_bags import BagMessage, joint_state, numbers, pose, transform, write_bag

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
<body><joint name="shoulder" type="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>
<body name="lower" pos="0 0 -0.3"><joint name="Elbow" type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/></body></body>
<body name="box" pos="0 1 0"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body></worldbody>
<actuator><motor name="m1" joint="shoulder"/><motor name="m2" joint="Elbow"/></actuator></mujoco>"""
NAMES, MS, BEGIN = ("Elbow", "shoulder"), 10**6, 1_700_000_000 * 10**9


@pytest.fixture
def simulator(tmp_path: Path) -> str:
    pytest.importorskip("mujoco", reason="mujoco is an extra")
    (tmp_path / "arm.xml").write_text(ARM)
    return str(tmp_path / "arm.xml")


def simulate_arm(seed: int, count: int = 40) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Simulate `count` rows of positions and commands (T, 2) of the arm, 10 ms apart."""
    mujoco = pytest.importorskip("mujoco", reason="mujoco is an extra")
    model = mujoco.MjModel.from_xml_string(ARM)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    data.qpos[:2] = rng.uniform(-1, 1, 2)
    positions, commands = np.empty((count, 2)), 0.1 * rng.standard_normal((count, 2))
    for row in range(count):
        positions[row], data.ctrl[:] = data.qpos[:2], commands[row]
        mujoco.mj_step(model, data, 5)
    return positions, commands


def write_table(path: Path, shots: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> Path:
    lines = ["shot,t,shoulder,elbow,m1,m2"]
    for shot, (positions, commands) in enumerate(shots):
        lines += [
            f"{shot},{k / 100!r},{','.join(map(repr, (*q.tolist(), *u.tolist())))}"
            for k, (q, u) in enumerate(zip(positions, commands, strict=True))
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


def list_states(
    positions: NDArray[np.float64], commands: NDArray[np.float64] | None = None, begin: int = BEGIN
) -> list[BagMessage]:
    """List joint states 10 ms apart, in an order of joints of their own, each after the command of its row."""
    messages: list[BagMessage] = []
    for row, q in enumerate(positions):
        t = begin + row * 10 * MS
        messages += [numbers(t, commands[row].tolist())] if commands is not None else []
        messages.append(joint_state(t, NAMES, q[::-1].tolist()))
    return messages


def require_same(one: MechanismShots, other: MechanismShots) -> None:
    assert len(one.recordings) == len(other.recordings)
    for a, b in zip(one.recordings, other.recordings, strict=True):
        assert (a.shot, a.bodies, a.reference) == (b.shot, b.bodies, b.reference)
        np.testing.assert_allclose(a.t, b.t, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(a.positions, b.positions)
        np.testing.assert_array_equal(a.sigma, b.sigma)
        np.testing.assert_allclose(one.histories[a.shot].t, other.histories[b.shot].t, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(one.histories[a.shot].values, other.histories[b.shot].values)


@pytest.mark.parametrize("ending", [".mcap", ".db3", ""])
def test_a_bag_gives_what_the_table_of_the_same_motion_gives(tmp_path: Path, simulator: str, ending: str):
    shots = [simulate_arm(seed) for seed in (1, 2)]
    bags = []
    for k, (positions, commands) in enumerate(shots):
        place = tmp_path / f"bag{k}{ending}"
        if not ending:
            place.mkdir()
            (place / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
        write_bag(place if ending else place / "bag_0.mcap", list_states(positions, commands))
        bags.append(place)
    table = write_table(tmp_path / "real.csv", shots)
    require_same(read_mechanism_shots(bags, simulator), read_mechanism_shots([table], simulator))


def test_a_pause_begins_another_shot_and_so_does_a_clock_that_begins_anew(tmp_path: Path, simulator: str):
    shots = [simulate_arm(seed) for seed in (1, 2, 3)]
    table = read_mechanism_shots([write_table(tmp_path / "real.csv", shots)], simulator)
    messages = [one for k, shot in enumerate(shots) for one in list_states(*shot, begin=BEGIN + k * 2000 * MS)]
    paused = read_mechanism_shots([write_bag(tmp_path / "paused.mcap", messages)], simulator)
    require_same(paused, table)
    assert "3 shots" in " ".join(paused.notes)
    assert paused.origins[2] == "paused.mcap, shot 2"
    # the clock of a simulation begins at 0 in every shot, and the log goes on
    anew = [(*one[:4], one[4] and (one[4] - BEGIN) % (2000 * MS)) for one in messages]
    begun = read_mechanism_shots([write_bag(tmp_path / "anew.mcap", anew)], simulator)
    require_same(begun, table)
    assert "another clock" in " ".join(begun.notes)


def test_inputs_hold_and_measurements_are_not_interpolated(tmp_path: Path):
    messages = [joint_state(BEGIN + k * 10 * MS, ("q",), [0.1 * k]) for k in range(10)]
    messages += [numbers(BEGIN + k * 25 * MS, [k]) for k in range(4)]
    messages += [joint_state(BEGIN + k * 30 * MS + 4 * MS, ("grip",), [1.0 + k], "/gripper") for k in (0, 1, 2, 5)]
    table = read_ros_recording(write_bag(tmp_path / "rates.mcap", messages))
    columns = table.columns
    np.testing.assert_allclose(columns["t"], np.arange(10) / 100, atol=1e-12)
    np.testing.assert_array_equal(columns["command0"], [0, 0, 0, 1, 1, 2, 2, 2, 3, 3])
    nan = np.nan
    np.testing.assert_array_equal(columns["grip"], [1, nan, nan, 2, nan, nan, 3, nan, nan, nan])
    assert "/gripper is up to 4 ms beside the time" in " ".join(table.notes)


def test_joints_that_two_drivers_publish_to_one_topic_are_all_read(tmp_path: Path):
    messages = []
    for k in range(6):
        messages.append(joint_state(BEGIN + k * 10 * MS, ("a", "b"), [k, -k]))
        if k % 2 == 0:
            messages.append(joint_state(BEGIN + k * 10 * MS + MS, ("grip",), [10.0 + k]))
    columns = read_ros_recording(write_bag(tmp_path / "two.mcap", messages)).columns
    np.testing.assert_array_equal(columns["b"], -np.arange(6))
    np.testing.assert_array_equal(columns["grip"], [10, np.nan, 12, np.nan, 14, np.nan])


def test_rows_before_the_first_command_are_left_out_with_a_note(tmp_path: Path):
    messages = [joint_state(BEGIN + k * 10 * MS, ("q",), [k]) for k in range(10)]
    messages += [numbers(BEGIN + k * 10 * MS, [k]) for k in range(4, 10)]
    table = read_ros_recording(write_bag(tmp_path / "late.mcap", messages))
    np.testing.assert_array_equal(table.columns["q"], np.arange(4, 10))
    assert "first 0.04 s" in " ".join(table.notes)


def test_commands_by_name_reach_the_actuator_of_their_joint(tmp_path: Path, simulator: str):
    states = list_states(simulate_arm(1)[0])
    asked = [joint_state(one[3], ("shoulder", "Elbow"), [], "/joint_command", effort=[0.5, -0.5]) for one in states]
    shots = read_mechanism_shots([write_bag(tmp_path / "real.mcap", states + asked)], simulator)
    np.testing.assert_array_equal(shots.histories[0].values[3], [0.5, -0.5])
    assert "the input m1 is shoulder_command" in " ".join(shots.notes)


def test_a_trajectory_of_one_point_is_a_command_and_others_are_left_out(tmp_path: Path):
    def ask(t: int, count: int) -> BagMessage:
        point = {"positions": [0.3], "velocities": [], "accelerations": [], "effort": []}
        points = [{**point, "time_from_start": {"sec": 0, "nanosec": 0}}] * count
        return f"/plan{count}", "trajectory_msgs/JointTrajectory", {"joint_names": ["q"], "points": points}, t, t

    messages = [joint_state(BEGIN + k * 10 * MS, ("q",), [k]) for k in range(4)]
    table = read_ros_recording(write_bag(tmp_path / "plan.mcap", [*messages, ask(BEGIN, 1), ask(BEGIN, 2)]))
    np.testing.assert_array_equal(table.columns["q_command"], 0.3)
    assert "left out: /plan2" in " ".join(table.notes)


@pytest.mark.parametrize("ending", [".mcap", ".db3"])
@pytest.mark.parametrize("field", ["reference", "desired"])
def test_what_a_controller_asks_for_is_a_command_where_the_bag_defines_its_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, field: str
):
    kind = "control_msgs/JointTrajectoryControllerState"
    text = f"std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint {field}"
    point = {"positions": [0.7], "velocities": [], "accelerations": [], "effort": []}
    state = {"joint_names": ["q"], field: {**point, "time_from_start": {"sec": 0, "nanosec": 0}}}
    messages = [joint_state(BEGIN + k * 10 * MS, ("q",), [k]) for k in range(4)]
    messages.append(("/arm/controller_state", kind, state, BEGIN, BEGIN))
    with monkeypatch.context() as patch:
        patch.setitem(DEFINITIONS, kind, text)
        bag = write_bag(tmp_path / f"real{ending}", messages, has_definitions=True)
    np.testing.assert_array_equal(read_ros_recording(bag).columns["q_command"], 0.7)


def test_measured_effort_is_an_input_only_of_an_actuator_with_the_name_of_the_joint(tmp_path: Path, simulator: str):
    positions, efforts = simulate_arm(1)
    messages = [
        joint_state(BEGIN + k * 10 * MS, NAMES, q[::-1].tolist(), effort=u[::-1].tolist())
        for k, (q, u) in enumerate(zip(positions, efforts, strict=True))
    ]
    bag = write_bag(tmp_path / "real.mcap", messages)
    assert not read_mechanism_shots([bag], simulator).histories[0].values.any()
    (tmp_path / "same.xml").write_text(ARM.replace('"m1"', '"shoulder"').replace('"m2"', '"elbow"'))
    shots = read_mechanism_shots([bag], str(tmp_path / "same.xml"))
    np.testing.assert_array_equal(shots.histories[0].values, efforts)
    assert "the input elbow is elbow_effort" in " ".join(shots.notes)
    silent = [
        (*one[:2], {**one[2], "effort": [0.0, 0.0]}, *one[3:]) for one in messages
    ]  # of a robot that measures none
    shots = read_mechanism_shots([write_bag(bag, silent)], str(tmp_path / "same.xml"))
    assert "no column for shoulder, elbow" in " ".join(shots.notes)


@pytest.mark.parametrize("by", ["PoseStamped", "TransformStamped", "TFMessage"])
def test_poses_of_free_bodies_are_columns(tmp_path: Path, simulator: str, by: str):
    turn = np.array([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
    messages: list[BagMessage] = []
    for k in range(20):
        t, place = BEGIN + k * 10 * MS, (0.1 * k, 1.0, -0.01 * k)
        messages.append(joint_state(t, NAMES, (0.2, 0.1 * k)))
        moved, link = transform(t, "world", "box", place, turn), transform(t, "box", "link", place, turn)
        kind, content = {
            "PoseStamped": ("geometry_msgs/PoseStamped", {"pose": pose(t, place, turn)}),
            "TransformStamped": ("geometry_msgs/TransformStamped", moved),
            "TFMessage": ("tf2_msgs/TFMessage", {"transforms": [moved, link]}),
        }[by]
        messages.append(("/mocap/box/pose", kind, content, t, t if by == "PoseStamped" else None))
    shots = read_mechanism_shots([write_bag(tmp_path / "real.mcap", messages)], simulator)
    first = shots.recordings[0]
    assert first.bodies == ("shoulder", "Elbow", "box.x", "box.y", "box.z", "box.rx", "box.ry", "box.rz")
    np.testing.assert_allclose(first.positions[5, 2:5, 0], [0.5, 1.0, -0.05], atol=1e-12)
    np.testing.assert_allclose(first.positions[5, 5:, 0], find_rotation(turn[[3, 0, 1, 2]]), atol=1e-12)
    assert "link" not in " ".join(shots.notes)


def test_topics_that_are_not_read_are_named_and_log_times_are_said_to_count(tmp_path: Path):
    messages = [joint_state(BEGIN + k * 10 * MS, ("q",), [k]) for k in range(5)]
    messages += [(topic, "std_msgs/String", {"data": "x"}, BEGIN, None) for topic in ("/camera", "/rosout")]
    bare = [(*one[:4], 0) if one[0] == "/joint_states" else one for one in messages]
    notes = " ".join(read_ros_recording(write_bag(tmp_path / "bare.mcap", bare)).notes)
    assert "left out: /camera" in notes
    assert "/rosout" not in notes
    assert "/joint_states has no time stamps" in notes
    np.testing.assert_allclose(read_ros_recording(tmp_path / "bare.mcap").columns["t"], np.arange(5) / 100, atol=1e-12)


def refuse(path: Path) -> str:
    with pytest.raises(OptionError) as refused:
        read_ros_recording(path)
    message = str(refused.value)
    assert "\n" not in message
    return message


def test_what_cannot_be_read_is_refused_in_a_sentence(tmp_path: Path):
    good = write_bag(tmp_path / "good.mcap", list_states(np.zeros((200, 2))))
    for share in (0.3, 0.9, 0.99):
        (tmp_path / "cut.mcap").write_bytes(good.read_bytes()[: int(share * good.stat().st_size)])
        assert "breaks off or is damaged" in refuse(tmp_path / "cut.mcap")
    (tmp_path / "cut.db3").write_bytes(b"SQLite format 3\0 and no more")
    assert "breaks off or is damaged" in refuse(tmp_path / "cut.db3")
    (tmp_path / "empty.mcap").write_bytes(b"")
    assert "breaks off or is damaged" in refuse(tmp_path / "empty.mcap")
    assert "holds no messages" in refuse(write_bag(tmp_path / "none.mcap", []))
    other = write_bag(tmp_path / "other.mcap", [("/note", "std_msgs/String", {"data": "x"}, BEGIN, None)])
    assert "/note (std_msgs/String): record /joint_states" in refuse(other)
    assert "no positions" in refuse(write_bag(tmp_path / "rates.mcap", [joint_state(BEGIN, ("q",), [])]))
    assert "there is no" in refuse(tmp_path / "missing.mcap")
    (tmp_path / "folder").mkdir()
    assert "holds no file .mcap or .db3" in refuse(tmp_path / "folder")


@pytest.mark.parametrize(
    ("encoding", "schema", "data", "part"),
    [
        ("json", ("jsonschema", b"{}"), b"{}", "encoded as json"),
        ("cdr", ("ros2msg", b"no definition at all ("), b"", "definition of sensor_msgs/JointState"),
        ("cdr", ("ros2idl", b"struct"), b"\0\1\0\0\1", "no whole sensor_msgs/JointState"),
    ],
)
def test_what_cannot_be_decoded_is_refused_in_a_sentence(
    tmp_path: Path, encoding: str, schema: tuple[str, bytes], data: bytes, part: str
):
    from mcap.writer import Writer

    with (tmp_path / "odd.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema("sensor_msgs/msg/JointState", *schema)
        writer.add_message(writer.register_channel("/joint_states", encoding, number), BEGIN, data, BEGIN)
        writer.finish()
    message = refuse(tmp_path / "odd.mcap")
    assert part in message
    assert "/joint_states" in message


def test_a_joint_without_a_column_is_refused_with_the_joints(tmp_path: Path, simulator: str):
    bag = write_bag(tmp_path / "real.mcap", [joint_state(BEGIN + k * MS, ("knee",), [k]) for k in range(5)])
    with pytest.raises(OptionError, match=r"knee.*shoulder, Elbow"):
        read_mechanism_shots([bag], simulator)


@pytest.mark.parametrize("package", ["mcap", "mcap_ros2.decoder"])
def test_a_package_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
):
    bag = write_bag(tmp_path / "real.mcap", [joint_state(BEGIN, ("q",), [0.0])])
    monkeypatch.setitem(sys.modules, package, None)
    assert "trueroll[simulators]" in refuse(bag)
