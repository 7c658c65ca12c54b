"""Recordings of ROS 2 as tables: MCAP files, and bags of MCAP or SQLite files.

A table has the columns that a person would write into a CSV: one per joint, `box.x` to `box.rz` for the pose of a body,
`elbow_command` for what a joint is asked for, or `command0, command1` where messages have no names, and `elbow_effort`
for the measured effort. Its rows are the times of the joint states.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.typing import FloatArray, IntArray
from pipeline.io.simulators.ros_messages import COMMAND_TOPIC, NamedValues, ValueRole, find_decoder, iterate_messages
from pipeline.io.text_table import TextTable
from pipeline.reporting.text.text_formatting import escape_text

_ENDINGS = (".mcap", ".db3")
# Pause in the joint states that begins another shot, ns. Episodes are a second apart and more; a number of sample
# intervals would cut a shot of a fast robot (20 of 1 kHz: 20 ms) wherever its computer is busy for a moment.
_PAUSE = 10**9
# Step back of the stamps from which the clock began anew, as that of a simulation does, ns; less is disorder.
_RESTART = 10**8
# Topics of every bag, which hold no measurement.
_USUAL_TOPICS = ("/rosout", "/parameter_events", "/clock", "/robot_description", "/tf_static")
# Topics that a note lists.
_MAX_TOPICS = 8


@dataclass(slots=True)
class _Series:
    """Messages of a topic that have the same C columns, at T times."""

    topic: str
    role: ValueRole
    names: tuple[str, ...]
    frame: str
    stamp_list: array[int] = field(default_factory=lambda: array("q"))
    log_list: array[int] = field(default_factory=lambda: array("q"))
    value_list: array[float] = field(default_factory=lambda: array("d"))

    @property
    def logs(self) -> IntArray:
        """(T,) ns, times of the log."""
        return np.array(self.log_list, np.int64)

    @property
    def stamps(self) -> IntArray:
        """(T,) ns, times of the headers."""
        return np.array(self.stamp_list, np.int64)

    @property
    def values(self) -> FloatArray:
        """(T, C) positions or commands."""
        return np.array(self.value_list).reshape(-1, len(self.names))

    @property
    def is_stamped(self) -> bool:
        """Whether the headers have times, and times that pass."""
        return max(self.stamp_list) > (min(self.stamp_list) if len(self.stamp_list) > 1 else 0)

    def add(self, one: NamedValues, log: int) -> None:
        """Add a message."""
        self.stamp_list.append(one.stamp)
        self.log_list.append(log)
        self.value_list.extend(one.values)


def is_ros_recording(path: Path) -> bool:
    """Return whether a path is a bag folder, or a file of one."""
    return path.is_dir() or path.suffix.lower() in _ENDINGS


def read_ros_recording(path: Path) -> TextTable:
    """Read the joints, poses and commands of an MCAP file or a bag.

    Args:
        path: A file .mcap or .db3, or a folder with some.

    Returns:
        The table; commands hold their last value, and a measurement between two rows stands in the nearer one.

    Raises:
        OptionError: There is no such file, a package is missing, it is damaged, or it has no joints and no poses.
    """
    place = escape_text(path)
    series, kinds = _collect_series(path)
    chosen = _choose_series(series)
    if not chosen or chosen[0].role > ValueRole.POSES:
        topics = _list_briefly(f"{topic} ({kind})" for topic, kind in kinds.items())
        raise OptionError(
            f"{place} has no positions in messages of sensor_msgs/JointState; it has {topics}: record /joint_states"
            if kinds
            else f"{place} holds no messages; record again"
        )
    clock = _Clock(chosen[0])
    times = [clock.place(one) for one in chosen]
    rows, cut = _skip_rows_before_commands(np.unique(times[0]), chosen, times)
    columns, shifts = _fill_columns(chosen, times, rows)
    notes = [f"{place}: {one}" for one in (cut, *clock.notes, *shifts) if one]
    shot = np.concatenate([[0], np.cumsum(np.diff(rows) > _PAUSE)])
    first = rows[np.searchsorted(shot, shot)]
    if shot[-1]:
        notes.append(f"{place}: {shot[-1] + 1} shots, parted where no joint state comes for a second")
    bare = [one.topic for one in chosen if not one.is_stamped and one.role != ValueRole.EFFORTS]
    if bare:
        notes.append(f"{place}: {_list_briefly(bare)} has no time stamps; the times of the log count")
    unused = {topic for topic in kinds if topic not in {one.topic for one in chosen}}.difference(_USUAL_TOPICS)
    if unused:
        notes.append(f"{place}: topics left out: {_list_briefly(sorted(unused))}")
    return TextTable(path, {"t": (rows - first) / 1e9, "shot": shot.astype(np.float64), **columns}, {}, tuple(notes))


def _list_files(path: Path) -> list[Path]:
    """List the files of a recording."""
    if not path.is_dir():
        if not path.is_file():
            raise OptionError(f"A recording was expected; there is no {escape_text(path)}")
        return [path]
    files = [one for one in path.iterdir() if one.suffix.lower() in _ENDINGS]
    if not files:
        raise OptionError(
            f"{escape_text(path)} holds no file .mcap or .db3 of a ROS 2 bag (unpack .zstd); name a bag or a table"
        )
    return sorted(files)  # any order does: messages are put in that of their log


def _collect_series(path: Path) -> tuple[list[_Series], dict[str, str]]:
    """Read all messages, and return their values, and the types of all topics."""
    series: dict[tuple[str, ValueRole, tuple[str, ...]], _Series] = {}
    kinds: dict[str, str] = {}
    for file in _list_files(path):
        decoders = {}
        for message in iterate_messages(file):
            topic = escape_text(message.topic)
            if topic not in decoders:
                kinds[topic], decoders[topic] = message.kind, find_decoder(message, escape_text(file))
            decoder = decoders[topic]
            for one in decoder(message) if decoder else ():
                if 0 < len(one.names) == len(one.values):
                    key = topic, one.role, one.names
                    if key not in series:
                        series[key] = _Series(topic, one.role, one.names, one.frame)
                    series[key].add(one, message.log)
    return list(series.values()), kinds


def _choose_series(series: Sequence[_Series]) -> list[_Series]:
    """Choose the series whose columns no other topic has, those with most messages first."""
    bodies = {one.names[0].partition(".")[0] for one in series if one.role == ValueRole.POSES}
    numbers = [one.topic for one in series if one.role == ValueRole.NUMBERS]
    orders = [topic for topic in numbers if COMMAND_TOPIC.search(topic)] or numbers * (len(set(numbers)) == 1)
    owners: dict[str, str] = {}
    chosen, count = [], 0
    for one in sorted(series, key=lambda one: (one.role, -len(one.log_list), one.topic)):
        if one.role == ValueRole.POSES and one.frame.rpartition("/")[2] in bodies:
            continue  # relative to another body: a link of a robot, not a free body
        if one.role == ValueRole.EFFORTS and not np.nan_to_num(one.values).any():
            continue  # of a robot that measures none
        if one.role == ValueRole.NUMBERS:
            if one.topic not in orders or one.topic in owners.values():
                continue
            one.names = tuple(f"command{count + k}" for k in range(len(one.names)))
            count += len(one.names)
        names = [name.lower() for name in one.names]
        if all(owners.get(name, one.topic) == one.topic for name in names):
            owners |= dict.fromkeys(names, one.topic)
            chosen.append(one)
    return chosen


class _Clock:
    """The time of the joint states, which passes even where their stamps begin anew."""

    def __init__(self, base: _Series) -> None:
        order = np.argsort(base.logs, kind="stable")
        self._logs = base.logs[order]
        self._is_stamped = base.is_stamped
        self._stamps = base.stamps[order] if base.is_stamped else self._logs
        step = np.diff(self._stamps)
        self._shift = np.concatenate([[0], np.cumsum(np.where(step < -_RESTART, 2 * _PAUSE - step, 0))])
        self._is_that_of_logs = not self._shift.any() and abs(float(np.median(self._logs - self._stamps))) < _PAUSE
        self.notes: list[str] = []

    def place(self, one: _Series) -> IntArray:
        """Return the times (T,) of messages, ns."""
        logs = one.logs
        if self._is_stamped and one.is_stamped:
            run = np.searchsorted(self._logs, logs, "right") - 1
            return np.asarray(one.stamps + self._shift[np.maximum(run, 0)])
        if self._is_that_of_logs:
            return logs
        self.notes.append(f"{one.topic} has no stamps and is placed by its order, as the log has another clock")
        begin = int(self._logs[0])
        placed = np.interp(logs - begin, self._logs - begin, self._stamps + self._shift - self._stamps[0])
        return np.asarray(self._stamps[0] + np.round(placed).astype(np.int64))


def _skip_rows_before_commands(
    rows: IntArray, chosen: Sequence[_Series], times: Sequence[IntArray]
) -> tuple[IntArray, str]:
    """Leave out the rows before the first command, in which nobody knows what holds the robot; return a note too."""
    commands = (ValueRole.COMMANDS, ValueRole.NUMBERS)
    first = [t.min() for one, t in zip(chosen, times, strict=True) if one.role in commands]
    late = rows[rows >= min(first, default=rows[0])]
    if len(late) in (0, len(rows)):
        return rows, ""
    return late, f"the first {(late[0] - rows[0]) / 1e9:.3g} s, before any command, are left out"


def _fill_columns(
    chosen: Sequence[_Series], times: Sequence[IntArray], rows: IntArray
) -> tuple[dict[str, FloatArray], list[str]]:
    """Fill the columns (K,) by name, and return notes; where series of a topic share a column, the longest counts."""
    columns: dict[str, FloatArray] = {}
    notes = []
    for one, t in zip(chosen, times, strict=True):
        if one.role <= ValueRole.POSES:
            values, shift = _match_rows(rows, t, one.values)
            if shift:
                notes.append(f"a measurement of {one.topic} is up to {shift / 1e6:.3g} ms beside the time of its row")
        else:
            values = _hold_values(rows, t, one.values)
        for name, column in zip(one.names, values.T, strict=True):
            plain = escape_text(name.lower())
            before = columns.get(plain, column)
            columns[plain] = np.where(np.isnan(before), column, before)
    return columns, notes


def _match_rows(rows: IntArray, times: IntArray, values: FloatArray) -> tuple[FloatArray, int]:
    """Put measurements (T, C) into the nearest rows (K, C), half an interval away at most; return the largest shift."""
    between = (rows[1:] + rows[:-1]) // 2
    near = np.searchsorted(between, times)
    distance = np.abs(rows[near] - times)
    order = np.argsort(distance, kind="stable")[::-1]  # of several in a row, the nearest is put there last
    order = order[distance[order] <= (np.median(np.diff(rows)) / 2 if len(rows) > 1 else 0)]
    matrix = np.full((len(rows), values.shape[1]), np.nan)
    matrix[near[order]] = values[order]
    return matrix, int(distance[order].max(initial=0))


def _hold_values(rows: IntArray, times: IntArray, values: FloatArray) -> FloatArray:
    """Return the last values (K, C) before or at each row; NaN before the first."""
    order = np.argsort(times, kind="stable")
    last = np.searchsorted(times[order], rows, "right") - 1
    return np.where(last[:, None] < 0, np.nan, values[order][np.maximum(last, 0)])


def _list_briefly(names: Iterable[str]) -> str:
    """List names, the first few of many."""
    texts = [escape_text(name) for name in names]
    more = len(texts) - _MAX_TOPICS
    return f"{', '.join(texts[:_MAX_TOPICS])}{f' and {more} more' if more > 0 else ''}"
