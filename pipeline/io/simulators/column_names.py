"""Which columns of a table are the joints and the inputs of a simulator, by their names or their order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.core.errors import OptionError
from models.estimation.gap_scenes.outside_simulator import Joint, OutsideSimulator
from pipeline.io.text_table import UNITS, TextTable
from pipeline.io.track_conventions import LENGTH_UNITS
from pipeline.reporting.text.text_formatting import escape_text

# Names of numbered columns, where a file does not use those of the simulator.
NUMBERED_JOINT = re.compile(r"(q|qpos|pos|position|joint|angle|theta|measured)_?\d*")
NUMBERED_INPUT = re.compile(r"(u|ctrl|control|command|cmd|input|action|asked|torque|target)_?\d*")
# Words of columns of positions, and of inputs, beside the name of their joint or actuator; words of actuators.
_JOINT_WORDS = frozenset(("joint", "jnt", "pos", "position", "angle", "q", "actual", "measured"))
_INPUT_WORDS = ("command", "ctrl", "cmd", "input", "target", "torque", "desired", "setpoint", "goal", "ref")
_EVERY_WORD = _JOINT_WORDS | {*_INPUT_WORDS, "servo", "motor", "actuator", "act"}
# Ending of the force or torque that a robot measures at a joint.
_EFFORT = "_effort"
WITH_UNIT = re.compile(r"(.+?)_*(?:[\[(]([^\[\]()]+)[\])]|_(deg|rad|m|cm|mm))")
# Columns that are neither joints nor inputs.
OTHER_COLUMNS = {"t", "time", "shot", "frame", "kind", "id", "sigma", "observed"}


def separate_units(table: TextTable, familiar: frozenset[str]) -> TextTable:
    """Separate the units from the names of columns that are not `familiar`: `elbow (deg)` is elbow, in degrees."""
    columns, units = dict(table.columns), dict(table.units)
    for name in table.columns:
        match = None if name in familiar else WITH_UNIT.fullmatch(name)
        unit = UNITS.get(match[2] or match[3]) if match else None
        if match and unit and match[1] not in columns:
            columns[match[1]], units[match[1]] = columns.pop(name), unit
    return replace(table, columns=columns, units=units)


def name_joints(table: TextTable) -> tuple[Joint, ...]:
    """Name joints by the columns of a table that are neither times nor inputs."""
    names = [n for n in table.columns if n not in OTHER_COLUMNS and not NUMBERED_INPUT.fullmatch(n)]
    return tuple(Joint(n, "m" if table.units.get(n, "rad") in LENGTH_UNITS else "rad") for n in names)


def find_joint_columns(table: TextTable, simulator: OutsideSimulator) -> tuple[tuple[Joint, ...], list[str], list[str]]:
    """Find the joints of a simulator that a table holds, their columns, and what was assumed."""
    named = [(joint, joint.name.lower()) for joint in simulator.joints if joint.name.lower() in table.columns]
    if named:
        return tuple(joint for joint, _ in named), [column for _, column in named], []
    shorts = {_shorten(name, _JOINT_WORDS): name for name in reversed(table.columns) if name not in OTHER_COLUMNS}
    keys = [(one, _shorten(one.name, _JOINT_WORDS)) for one in simulator.joints]
    close = [(one, shorts[key]) for one, key in keys if key and key in shorts]
    how = "by their names"
    if not close or len({column for _, column in close}) < len(close):
        columns = [name for name in table.columns if NUMBERED_JOINT.fullmatch(name)]
        single = [joint for joint in simulator.joints if "." not in joint.name]
        close = list(zip(single, columns, strict=True)) if len(columns) == len(single) else []
        how = "by their order"
    if close:
        pairs = ", ".join(f"{column} is {joint.name}" for joint, column in close)
        note = f"{escape_text(table.path)}: {how}, {pairs}"
        return tuple(joint for joint, _ in close), [column for _, column in close], [note]
    wanted = ", ".join(joint.name for joint in simulator.joints)
    raise OptionError(
        f"{escape_text(table.path)} has the columns {', '.join(table.columns)}; the joints of the simulator are"
        f" {wanted}: give both the same names"
    )


def _shorten(name: str, words: frozenset[str]) -> str:
    """Return a name in lower case without certain words: `elbow_joint` and `elbow_pos` are elbow."""
    return "_".join(word for word in re.split(r"[_./ -]+", name.lower()) if word not in words)


def find_input_columns(
    table: TextTable, simulator: OutsideSimulator, taken: Sequence[str]
) -> tuple[list[str | None], list[str]]:
    """Find the columns of all inputs, None where one is not recorded, and what was assumed."""
    place, notes = escape_text(table.path), list[str]()
    free = [name for name in table.columns if name not in taken]
    chosen_columns = [_find_input_column(free, simulator, number) for number in range(len(simulator.inputs))]
    for name, column in zip(simulator.inputs, chosen_columns, strict=True):
        plain = name.lower()
        if column not in (None, plain) and str(column).removeprefix(f"{plain}_") not in _INPUT_WORDS:
            notes.append(f"{place}: the input {name} is {column}")
    columns: list[str | None] = [name for name in free if NUMBERED_INPUT.fullmatch(name)]
    if not any(chosen_columns) and len(columns) == len(simulator.inputs):
        ordered = dict(zip(_order_inputs(simulator, columns), columns, strict=True))
        pairs = ", ".join(f"{column} is {simulator.inputs[k]}" for k, column in ordered.items())
        return [ordered[k] for k in range(len(columns))], [f"{place}: the input {pairs}"] if pairs else []
    silent = [name for name, column in zip(simulator.inputs, chosen_columns, strict=True) if column is None]
    if silent:
        notes.append(f"{place} has no column for {', '.join(silent)}: taken for 0 all the time")
    return chosen_columns, notes


def _order_inputs(simulator: OutsideSimulator, columns: Sequence[str | None]) -> list[int]:
    """Order inputs as their numbered columns are: as their joints, for which `command3` belongs to `q3`.

    Columns called `ctrl`, as MuJoCo calls its inputs, and inputs that share a joint have the order of the simulator.
    """
    joints = [one.joint for one in simulator.drives]
    has_own = len(joints) == len(set(joints)) == len(columns) and min(joints, default=-1) >= 0
    is_ctrl = all(column is not None and column.startswith("ctrl") for column in columns)
    return np.argsort(joints).tolist() if has_own and not is_ctrl else list(range(len(columns)))


def _find_input_column(columns: Sequence[str], simulator: OutsideSimulator, number: int) -> str | None:
    """Find the column of an input: its name, or that or its only joint with a word for inputs.

    A motor whose input has no such column takes the effort that a robot measures there.
    """
    name, drives = simulator.inputs[number].lower(), [one.joint for one in simulator.drives]
    own = drives[number] if drives else -1
    joint = simulator.joints[own].name if own >= 0 and drives.count(own) == 1 else name
    if name in columns:
        return name
    for owner in (name, joint):
        for word in _INPUT_WORDS:
            for column in columns:
                parts = re.split(r"[_./ -]+", column)
                if word in parts and _shorten(column, _EVERY_WORD) == _shorten(owner, _EVERY_WORD) != "":
                    return column
    effort = f"{name}{_EFFORT}"
    return effort if simulator.servo_joints[number] < 0 and effort in columns else None
