"""Recordings of a mechanism: tables with a row per time, and a column per joint and per input of its simulator.

Columns are found by their names: those of the simulator, in any case, or else numbered ones in its order (`q0, q1`, and
`command0, command1` for inputs). Inputs hold from row to row; an empty cell means that the actuator has no power.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pyarrow import ArrowException, parquet

from models.core.errors import OptionError
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray
from models.estimation.gap_scenes.outside_simulator import InputHistory, Joint, OutsideSimulator
from pipeline.io.simulators.function_simulator import read_function
from pipeline.io.simulators.mujoco_simulator import read_mujoco_file
from pipeline.io.simulators.recorded_simulator import RecordedSimulator
from pipeline.io.text_table import UNITS, TextTable, name_columns, read_text_table
from pipeline.io.track_conventions import ANGLE_UNITS, LENGTH_UNITS, MAX_NUMBER
from pipeline.reporting.text.text_formatting import escape_text

# Standard deviation of positions without a stated one, rad or m; the diagnosis estimates it.
_USUAL_SIGMA = 1e-3
# Names of numbered columns, where a file does not use those of the simulator.
_NUMBERED_JOINT = re.compile(r"(q|qpos|pos|position|joint|angle|theta|measured)_?\d*")
_NUMBERED_INPUT = re.compile(r"(u|ctrl|control|command|cmd|input|action|asked|torque|target)_?\d*")
_WITH_UNIT = re.compile(r"(.+?)_*(?:[\[(]([^\[\]()]+)[\])]|_(deg|rad|m|cm|mm))")
# Columns that are neither joints nor inputs.
_OTHER_COLUMNS = {"t", "time", "shot", "episode", "frame", "kind", "id", "sigma", "observed"}
# Limits of a joint from which angles without a unit are degrees: stops give a little, and degrees are 57 times as many.
_MOST_LIMITS = 3.0


@dataclass(frozen=True, slots=True)
class MechanismShots:
    """A simulator, and recordings of its joints."""

    simulator: OutsideSimulator
    recordings: tuple[Recording, ...]
    """One per shot; the bodies are joints."""
    histories: Mapping[int, InputHistory]
    """Inputs by shot."""
    notes: tuple[str, ...]
    """What was assumed, in sentences without a full stop."""
    origins: Mapping[int, str]
    """File and number there by shot."""


def read_mechanism_shots(paths: Sequence[Path], simulator_name: str) -> MechanismShots:
    """Open a simulator and read recordings of its joints.

    Args:
        paths: Tables of text or Parquet files.
        simulator_name: `FILE.xml` of MuJoCo, `MODULE:FUNCTION` of Python, or a table of simulated positions.

    Returns:
        The simulator and the shots.

    Raises:
        OptionError: Something cannot be read, or the columns do not fit the simulator.
    """
    tables = [_read_table(path) for path in paths]
    simulated = None
    place = Path(simulator_name)
    if place.suffix.lower() in (".xml", ".urdf", ".mjb"):
        simulator: OutsideSimulator = read_mujoco_file(place)
    elif place.is_file():
        simulated = _read_table(place)
        joints = _name_joints(simulated)
        parts = _split_shots(simulated, joints, [joint.name for joint in joints], ())
        simulator = RecordedSimulator(joints, tuple(_record(part, k, joints) for k, part in enumerate(parts)))
    elif ":" in simulator_name:
        names = [joint.name for joint in _name_joints(tables[0])]
        simulator = read_function(simulator_name, names, tables[0].units)
    else:
        raise OptionError(
            "--simulator takes FILE.xml of MuJoCo, MODULE:FUNCTION of Python, or a table of simulated positions; got"
            f" {escape_text(simulator_name)}"
        )
    return _match_shots(tables, simulator)


def _match_shots(tables: Sequence[TextTable], simulator: OutsideSimulator) -> MechanismShots:
    """Read the shots of all tables, numbered one after another."""
    recordings: list[Recording] = []
    histories, origins, notes = {}, {}, []
    for table in tables:
        joints, columns, assumed = _find_joint_columns(table, simulator)
        inputs, more = _find_input_columns(table, simulator)
        notes += [*table.notes, *assumed, *more]
        for part in _split_shots(table, joints, columns, inputs):
            shot = len(recordings)
            recordings.append(_record(part, shot, joints))
            histories[shot] = InputHistory(part.t, part.inputs)
            origins[shot] = f"{table.path.name}, shot {part.number}"
    names = {one.bodies for one in recordings}
    if len(names) > 1:
        raise OptionError("The recordings have columns for different joints; diagnose them separately")
    return MechanismShots(simulator, tuple(recordings), histories, tuple(dict.fromkeys(notes)), origins)


def _read_table(path: Path) -> TextTable:
    """Read a table of text or a Parquet file, and the units in the names of its columns."""
    if path.suffix.lower() != ".parquet":
        return _separate_units(read_text_table(path, "A recording of a mechanism was expected"))
    try:
        table = parquet.read_table(path)
    except (OSError, ArrowException) as error:
        raise OptionError(f"{escape_text(path)} is no whole Parquet file; export it again") from error
    columns = {name.lower(): table.column(name) for name in table.column_names}
    return _separate_units(name_columns(path, columns, {}, []))


def _separate_units(table: TextTable) -> TextTable:
    """Separate the units from the names of columns: `elbow (deg)` and `elbow_deg` are elbow, in degrees."""
    columns, units = dict(table.columns), dict(table.units)
    for name in table.columns:
        match = _WITH_UNIT.fullmatch(name)
        unit = UNITS.get(match[2] or match[3]) if match else None
        if match and unit and match[1] not in columns:
            columns[match[1]], units[match[1]] = columns.pop(name), unit
    return replace(table, columns=columns, units=units)


def _name_joints(table: TextTable) -> tuple[Joint, ...]:
    """Name joints by the columns of a table that are neither times nor inputs."""
    names = [n for n in table.columns if n not in _OTHER_COLUMNS and not _NUMBERED_INPUT.fullmatch(n)]
    return tuple(Joint(n, "m" if table.units.get(n, "rad") in LENGTH_UNITS else "rad") for n in names)


def _find_joint_columns(
    table: TextTable, simulator: OutsideSimulator
) -> tuple[tuple[Joint, ...], list[str], list[str]]:
    """Find the joints of a simulator that a table holds, their columns, and what was assumed."""
    named = [(joint, joint.name.lower()) for joint in simulator.joints if joint.name.lower() in table.columns]
    if named:
        return tuple(joint for joint, _ in named), [column for _, column in named], []
    columns = [name for name in table.columns if _NUMBERED_JOINT.fullmatch(name)]
    single = [joint for joint in simulator.joints if "." not in joint.name]
    if columns and len(columns) == len(single):
        pairs = ", ".join(f"{column} is {joint.name}" for column, joint in zip(columns, single, strict=True))
        return tuple(single), columns, [f"{escape_text(table.path)}: by their order, {pairs}"]
    wanted = ", ".join(joint.name for joint in simulator.joints)
    raise OptionError(
        f"{escape_text(table.path)} has the columns {', '.join(table.columns)}; the joints of the simulator are"
        f" {wanted}: name columns after joints"
    )


def _find_input_columns(table: TextTable, simulator: OutsideSimulator) -> tuple[list[str | None], list[str]]:
    """Find the columns of all inputs, None where one is not recorded, and what was assumed."""
    named: list[str | None] = [name.lower() if name.lower() in table.columns else None for name in simulator.inputs]
    taken = {joint.name.lower() for joint in simulator.joints}
    named = [None if name in taken else name for name in named]
    columns: list[str | None] = [name for name in table.columns if _NUMBERED_INPUT.fullmatch(name)]
    if any(named) or not simulator.inputs:
        return named, []
    if len(columns) == len(simulator.inputs):
        pairs = ", ".join(f"{column} is {name}" for column, name in zip(columns, simulator.inputs, strict=True))
        return columns, [f"{escape_text(table.path)}: the input {pairs}"]
    place = escape_text(table.path)
    return [None] * len(simulator.inputs), [f"{place} has no inputs, so that all actuators are told 0"]


@dataclass(frozen=True, slots=True)
class _Part:
    """Rows of one shot."""

    number: int
    t: FloatArray
    positions: FloatArray
    """(T, B) rad or m."""
    sigma: FloatArray
    """(T,) NaN where it is not stated."""
    inputs: FloatArray
    """(T, I)"""


def _split_shots(
    table: TextTable, joints: tuple[Joint, ...], columns: list[str], inputs: Sequence[str | None]
) -> list[_Part]:
    """Split the rows of a table into shots."""
    place = escape_text(table.path)
    table.require(["t"])
    t = table.columns["t"] * {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}.get(table.units.get("t", "s"), 1.0)
    count = len(t)
    shots = table.columns.get("shot", table.columns.get("episode", np.zeros(count)))
    positions = np.stack(
        [_convert(table, joint, column) for joint, column in zip(joints, columns, strict=True)], axis=1
    )
    given = [np.zeros(count) if name is None else table.columns[name] for name in inputs]
    values = np.stack(given, axis=1) if given else np.zeros((count, 0))
    sigma = table.columns.get("sigma", np.full(count, np.nan))
    parts = []
    for number in np.unique(shots[np.isfinite(shots)]):
        rows = np.flatnonzero((shots == number) & np.isfinite(t))
        if not (np.diff(t[rows]) > 0).all():
            back = float(t[rows][int(np.argmin(np.diff(t[rows]))) + 1])
            raise OptionError(
                f"{place}: t goes back, or stands still, at {back:g} s of shot {number:g}; sort its rows, or number"
                " shots in a column shot"
            )
        parts.append(_Part(int(number), t[rows], positions[rows], sigma[rows], values[rows]))
    if not parts:
        raise OptionError(f"{place} has no rows with a time")
    return parts


def _convert(table: TextTable, joint: Joint, column: str) -> FloatArray:
    """Return the positions (T,) of a joint in rad or m."""
    values, unit = table.columns[column], table.units.get(column)
    factors = ANGLE_UNITS if joint.unit == "rad" else LENGTH_UNITS
    if unit is not None and unit not in factors:
        raise OptionError(
            f"{escape_text(table.path)}: {column} is in {unit}; the joint {joint.name} is in {joint.unit}"
        )
    values = np.where(np.abs(values) < MAX_NUMBER, values, np.nan)
    most = float(np.nanmax(np.abs(values), initial=0.0))
    if unit is None and joint.unit == "rad" and most > _MOST_LIMITS * joint.limit:
        raise OptionError(
            f"{escape_text(table.path)}: {column} goes up to {most:.3g}, but the simulator stops {joint.name} at"
            f" {joint.limit:.3g} rad; if it is in degrees, name the column {column} (deg)"
        )
    return np.asarray(values * factors[unit or joint.unit])


def _record(part: _Part, shot: int, joints: tuple[Joint, ...]) -> Recording:
    """Record the rows of a shot; one joint is one body with one coordinate."""
    units = {joint.unit for joint in joints}
    is_stated = bool(np.isfinite(part.sigma).all() and (part.sigma > 0).all())
    sigma = part.sigma if is_stated else np.full(len(part.t), _USUAL_SIGMA)
    reference = ReferenceFrame(("q",), units.pop() if len(units) == 1 else "rad", "of the joints")
    return Recording(
        shot, np.arange(len(part.t)), part.t, tuple(joint.name for joint in joints), part.positions[:, :, None],
        np.repeat(sigma[:, None], len(joints), axis=1), reference, is_stated,
    )  # fmt: skip
