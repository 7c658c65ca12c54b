"""Messages of ROS 2 with the positions or commands of a mechanism, from MCAP files and SQLite bags (.db3)."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from models.core.errors import OptionError
from pipeline.engine.extras import import_mcap, name_remedy
from pipeline.io.simulators.mujoco_simulator import FREE_NAMES, find_rotation
from pipeline.reporting.text.text_formatting import escape_text

# Endings of topics whose joint states are asked for rather than measured, such as Isaac's /joint_command.
COMMAND_TOPIC = re.compile(r"command|cmd|desired|target|goal|reference|setpoint", re.IGNORECASE)
# What the topic of a pose has after the name of its body.
_POSE_ENDING = re.compile(r"(^|[/_])pose(_stamped)?$", re.IGNORECASE)
# Definitions of the messages that are read, for bags that do not hold them (SQLite before ROS 2 Iron, IDL).
DEFINITIONS = {
    "sensor_msgs/JointState":
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/TransformStamped":
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "std_msgs/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    "trajectory_msgs/JointTrajectory":
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points",
    "trajectory_msgs/JointTrajectoryPoint":
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
}  # fmt: skip
_SELECT_MESSAGES = """SELECT topics.name, topics.type, topics.serialization_format, messages.timestamp, messages.data
FROM messages JOIN topics ON topics.id = messages.topic_id ORDER BY messages.timestamp"""
_SELECT_DEFINITIONS = """SELECT topic_type, encoded_message_definition
FROM message_definitions WHERE encoding = 'ros2msg'"""
_SELECT_TABLE = "SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"


class ValueRole(IntEnum):
    """What the values of a message are, in the order in which topics are chosen."""

    JOINTS = 0
    POSES = 1
    COMMANDS = 2
    """With the names of their joints."""
    NUMBERS = 3
    """Commands without names."""
    EFFORTS = 4


@dataclass(frozen=True, slots=True)
class NamedValues:
    """Values of one message with the names of their columns."""

    role: ValueRole
    names: tuple[str, ...]
    values: Sequence[float]
    stamp: int
    """ns; 0 where the message has none."""
    frame: str = ""
    """Frame of a pose."""


@dataclass(frozen=True, slots=True)
class RosMessage:
    """A message as a file holds it."""

    topic: str
    kind: str
    """Type, such as sensor_msgs/JointState."""
    encoding: str
    definition: str
    """In the language of .msg files; empty where the file has it in no such form."""
    log: int
    """ns, time of its log."""
    data: bytes


def build_definition(kind: str) -> str:
    """Build the definition of a message with those of its parts; empty where none is in `DEFINITIONS`."""
    if kind not in DEFINITIONS:
        return ""
    parts = (f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in DEFINITIONS.items() if name != kind)
    return "\n".join((DEFINITIONS[kind], *parts))


def iterate_messages(path: Path) -> Iterator[RosMessage]:
    """Iterate over all messages of a file in its order.

    Args:
        path: A file .mcap or .db3.

    Yields:
        The messages.

    Raises:
        OptionError: The package mcap is missing, or the file is damaged.
    """
    try:
        yield from (_iterate_sqlite if path.suffix.lower() == ".db3" else _iterate_mcap)(path)
    except OptionError:
        raise
    except Exception as error:  # parsers raise what they like
        remedy = "copy it again" if path.suffix.lower() == ".db3" else "copy it again, or repair it with `mcap recover`"
        raise OptionError(f"{escape_text(path)} breaks off or is damaged; {remedy}") from error


def _iterate_mcap(path: Path) -> Iterator[RosMessage]:
    """Read an MCAP file from its beginning, as one that breaks off has no index."""
    with path.open("rb") as file:
        reader = import_mcap().reader.NonSeekingReader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            is_text = schema is not None and schema.encoding == "ros2msg"
            yield RosMessage(
                channel.topic, _shorten_kind(schema.name if schema else ""), channel.message_encoding,
                schema.data.decode() if is_text else "", message.log_time, message.data,
            )  # fmt: skip


def _iterate_sqlite(path: Path) -> Iterator[RosMessage]:
    """Read a file of the storage sqlite3 of rosbag2."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        has_definitions = base.execute(_SELECT_TABLE).fetchone() is not None
        definitions = dict(base.execute(_SELECT_DEFINITIONS)) if has_definitions else {}
        for topic, kind, encoding, log, data in base.execute(_SELECT_MESSAGES):
            yield RosMessage(topic, _shorten_kind(kind), encoding, definitions.get(kind, ""), log, data)


def _shorten_kind(name: str) -> str:
    return name.replace("/msg/", "/")


def find_decoder(message: RosMessage, place: str) -> Callable[[RosMessage], tuple[NamedValues, ...]] | None:
    """Find what extracts the values of the messages of a topic.

    Args:
        message: One of them.
        place: Name of the file, for messages of errors.

    Returns:
        A function of a message; None where messages of this type are not read.

    Raises:
        OptionError: The package mcap-ros2-support is missing, or the messages are not encoded as in ROS 2.
    """
    if message.kind not in _EXTRACTORS or message.topic.endswith("tf_static"):
        return None
    definition, topic = message.definition or build_definition(message.kind), escape_text(message.topic)
    if message.encoding != "cdr":
        raise OptionError(
            f"{place}: {topic} is encoded as {escape_text(message.encoding) or 'nothing stated'}; messages of"
            " ROS 2 (cdr) are read, so convert the recording to them"
        )
    if not definition:
        return None
    try:
        from mcap.records import Schema
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise OptionError(
            f"Messages of ROS 2 need the package mcap-ros2-support; {name_remedy('simulators')}"
        ) from error
    try:
        schema = Schema(id=1, data=definition.encode(), encoding="ros2msg", name=message.kind)
        decode = DecoderFactory().decoder_for("cdr", schema)
    except Exception as error:  # of a parser
        raise OptionError(
            f"{place}: the definition of {message.kind} of {topic} cannot be read; record it again"
        ) from error

    def extract(one: RosMessage) -> tuple[NamedValues, ...]:
        try:
            return tuple(_EXTRACTORS[one.kind](one.topic, decode(one.data)))
        except Exception as error:  # of a parser
            raise OptionError(
                f"{place}: a message of {topic} is no whole {one.kind}; record it again, or leave out the topic"
            ) from error

    return extract


def _read_stamp(header: Any) -> int:
    """Return the stamp of a header, ns."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _name_commands(joints: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{joint}_command" for joint in joints)


def _extract_joints(topic: str, message: Any) -> Iterator[NamedValues]:
    """Extract the positions and efforts of joints, or what they are asked for."""
    stamp, names = _read_stamp(message.header), tuple(message.name)
    if COMMAND_TOPIC.search(topic.rpartition("/")[2]):
        values = next(filter(len, (message.position, message.velocity, message.effort)), ())
        yield NamedValues(ValueRole.COMMANDS, _name_commands(names), values, stamp)
        return
    yield NamedValues(ValueRole.JOINTS, names, message.position, stamp)
    yield NamedValues(ValueRole.EFFORTS, tuple(f"{name}_effort" for name in names), message.effort, stamp)


def _name_pose(body: str, place: Any, turn: Any, header: Any) -> NamedValues:
    """Name the six coordinates of a body: its place, and its rotation vector."""
    vector = find_rotation(np.array([turn.w, turn.x, turn.y, turn.z]))
    values = (place.x, place.y, place.z, *vector.tolist())
    names = tuple(f"{body.rpartition('/')[2]}.{axis}" for axis in FREE_NAMES)
    return NamedValues(ValueRole.POSES, names, values, _read_stamp(header), header.frame_id.strip("/"))


def _extract_pose(topic: str, message: Any) -> Iterator[NamedValues]:
    """Extract the pose of the body that the topic names: /mocap/box/pose, /box_pose."""
    yield _name_pose(_POSE_ENDING.sub("", topic), message.pose.position, message.pose.orientation, message.header)


def _extract_transforms(topic: str, message: Any) -> Iterator[NamedValues]:
    """Extract the poses of child frames, from one transform or several."""
    for one in getattr(message, "transforms", (message,)):
        yield _name_pose(one.child_frame_id, one.transform.translation, one.transform.rotation, one.header)


def _extract_numbers(topic: str, message: Any) -> Iterator[NamedValues]:
    """Extract commands in the order of their controller."""
    yield NamedValues(ValueRole.NUMBERS, tuple(map(str, range(len(message.data)))), message.data, 0)


def _extract_trajectory(topic: str, message: Any) -> Iterator[NamedValues]:
    """Extract a command that acts at once; what a controller does between several points is not in the message."""
    if len(message.points) == 1:
        point = message.points[0]
        if point.time_from_start.sec == 0 == point.time_from_start.nanosec:
            values = next(filter(len, (point.positions, point.velocities, point.effort)), ())
            yield NamedValues(
                ValueRole.COMMANDS, _name_commands(message.joint_names), values, _read_stamp(message.header)
            )


def _extract_controller_state(topic: str, message: Any) -> Iterator[NamedValues]:
    """Extract what a trajectory controller asks for at a time: `desired` before ROS 2 Iron, now `reference`."""
    points = (getattr(message, name) for name in ("reference", "desired") if hasattr(message, name))
    values = next((one.positions for one in points if len(one.positions)), ())
    yield NamedValues(ValueRole.COMMANDS, _name_commands(message.joint_names), values, _read_stamp(message.header))


_EXTRACTORS: dict[str, Callable[[str, Any], Iterator[NamedValues]]] = {
    "sensor_msgs/JointState": _extract_joints,
    "geometry_msgs/PoseStamped": _extract_pose,
    "geometry_msgs/TransformStamped": _extract_transforms,
    "tf2_msgs/TFMessage": _extract_transforms,
    "std_msgs/Float64MultiArray": _extract_numbers,
    "trajectory_msgs/JointTrajectory": _extract_trajectory,
    "control_msgs/JointTrajectoryControllerState": _extract_controller_state,
}
