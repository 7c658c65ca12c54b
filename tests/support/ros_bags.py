"""Small bags of ROS 2, written with the packages that write real ones."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

from pipeline.io.simulators.ros_messages import build_definition

# Topic, type without /msg/, content, and times of the log and of the header in ns; None where it has none.
BagMessage = tuple[str, str, dict[str, Any], int, int | None]


def joint_state(
    t: int, names: Sequence[str], positions: Sequence[float], topic: str = "/joint_states", **more: Any
) -> BagMessage:
    """Make a joint state at `t` ns."""
    content = {"name": list(names), "position": list(positions), "velocity": [], "effort": [], **more}
    return topic, "sensor_msgs/JointState", content, t, t


def numbers(t: int, values: Sequence[float], topic: str = "/motors/commands") -> BagMessage:
    """Make a command without names or a stamp."""
    return topic, "std_msgs/Float64MultiArray", {"data": list(values), "layout": {"dim": [], "data_offset": 0}}, t, None


def pose(t: int, place: Sequence[float], turn: Sequence[float]) -> dict[str, Any]:
    """Make the content of a pose; `turn` is a quaternion, w last."""
    return {"position": dict(zip("xyz", place, strict=True)), "orientation": dict(zip("xyzw", turn, strict=True))}


def transform(t: int, parent: str, child: str, place: Sequence[float], turn: Sequence[float]) -> dict[str, Any]:
    """Make a stamped transform."""
    content = {"translation": dict(zip("xyz", place, strict=True)), "rotation": dict(zip("xyzw", turn, strict=True))}
    return {"header": _make_header(t, parent), "child_frame_id": child, "transform": content}


def write_bag(path: Path, messages: Sequence[BagMessage], has_definitions: bool = False) -> Path:
    """Write an MCAP file, or a bag of SQLite, which has no definitions in ROS 2 Humble."""
    if path.suffix == ".db3":
        return _write_sqlite(path, messages, has_definitions)
    from mcap_ros2.writer import Writer

    with path.open("wb") as file, Writer(file) as writer:
        schemas = {}
        for topic, kind, content, log, stamp in messages:
            if kind not in schemas:
                package, _, name = kind.partition("/")
                text = build_definition(kind) or "string data"
                schemas[kind] = writer.register_msgdef(f"{package}/msg/{name}", text)
            writer.write_message(topic, schemas[kind], _add_header(content, stamp), log_time=log)
    return path


def _write_sqlite(path: Path, messages: Sequence[BagMessage], has_definitions: bool) -> Path:
    """Write what rosbag2 calls sqlite3; the data are those that an MCAP file of the same messages holds."""
    from mcap.reader import make_reader

    whole = write_bag(path.with_suffix(".mcap"), messages)
    rows = list(make_reader(BytesIO(whole.read_bytes())).iter_messages())
    whole.unlink()
    topics = {channel.topic: (channel.id, schema.name) for schema, channel, _ in rows}
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        base.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        base.executemany(
            "INSERT INTO topics VALUES (?, ?, ?, 'cdr')", [(k, name, kind) for name, (k, kind) in topics.items()]
        )
        if has_definitions:
            base.execute(
                "CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT, encoded_message_definition TEXT)"
            )
            texts = {schema.name: schema.data.decode() for schema, _, _ in rows}
            base.executemany("INSERT INTO message_definitions VALUES (?, 'ros2msg', ?)", list(texts.items()))
        contents = [(k, channel.id, one.log_time, one.data) for k, (_, channel, one) in enumerate(rows)]
        base.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", contents)
    return path


def _make_header(t: int, frame: str = "") -> dict[str, Any]:
    return {"stamp": {"sec": t // 10**9, "nanosec": t % 10**9}, "frame_id": frame}


def _add_header(content: dict[str, Any], stamp: int | None) -> dict[str, Any]:
    return content if stamp is None or "header" in content else {"header": _make_header(stamp), **content}
