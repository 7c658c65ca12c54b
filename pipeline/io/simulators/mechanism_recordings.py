"""Recordings of a mechanism: tables with a row per time, and a column per joint and per input of its simulator.

Columns are found by their names: those of the simulator, in any case, with or without words such as `joint`, `pos` and
`cmd`, or else numbered ones in its order (`q0, q1`, and `command0, command1` for inputs); an input may be called like
the joint that it alone drives. Inputs hold from row to row; an empty cell means that the actuator has no power.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from pyarrow import ArrowException, parquet

from diagnosis.fitting.diagnosis_windows import MIN_ROWS
from models.core.errors import OptionError
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray
from models.estimation.gap_scenes.mechanism_inputs import InputHistory
from models.estimation.gap_scenes.outside_simulator import Joint, OutsideSimulator
from pipeline.io.long_recordings import cut_long_recordings, describe_times
from pipeline.io.simulators.column_names import (
    NUMBERED_INPUT,
    NUMBERED_JOINT,
    OTHER_COLUMNS,
    WITH_UNIT,
    find_input_columns,
    find_joint_columns,
    name_joints,
    separate_units,
)
from pipeline.io.simulators.function_simulator import read_function, try_function
from pipeline.io.simulators.mujoco_simulator import read_mujoco_file
from pipeline.io.simulators.recorded_simulator import RecordedSimulator
from pipeline.io.simulators.ros_recording import is_ros_recording, read_ros_recording
from pipeline.io.text_table import ALIASES, TextTable, name_columns, read_text_table
from pipeline.io.track_conventions import ANGLE_UNITS, LENGTH_UNITS, MAX_NUMBER, TIME_UNITS
from pipeline.reporting.text.text_formatting import escape_text

# Standard deviation of positions without a stated one, rad or m; the diagnosis estimates it.
_USUAL_SIGMA = 1e-3
# Recorded poses in which bodies are tested for contact: a second of a fast robot.
_MOST_POSES = 500
# Least number of recorded poses, at rest, from which a function is tried: mixed-up runs show already with two.
_TRIED_STATES = 5
# Share of a turn by which a recorded angle jumps where a sensor begins anew: no joint turns as far between two rows.
_JUMP_SHARE = 0.75
# Largest rotation vector, rad, of a body whose turns are compared: at half a turn it jumps to the other side.
_LARGEST_TURN = 0.9 * np.pi
# Similarity of the names of a column that is not used and of a joint or input that is not recorded, from which one of
# them may be misspelt: two letters of four that changed places, but not a word more such as `vel`.
_ALIKE_NAMES = 0.75
# Multiple of a joint's limit above which angles without a unit are taken for degrees: stops give a little, and degrees
# are 57 times as many.
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
    """File and number there by shot, and times where shots are pieces of a recording."""

    @property
    def run_count(self) -> int:
        """Number of recorded runs: pieces of one share its inputs."""
        return len({id(history) for history in self.histories.values()})


def read_mechanism_shots(paths: Sequence[Path], simulator_name: str) -> MechanismShots:
    """Open a simulator and read recordings of its joints.

    Args:
        paths: Tables of text, Parquet files, MCAP files or ROS 2 bags.
        simulator_name: `FILE.xml` of MuJoCo, `MODULE:FUNCTION` of Python, or a table of simulated positions.

    Returns:
        The simulator and the shots.

    Raises:
        OptionError: Something cannot be read, or the columns do not fit the simulator.
    """
    shots = _read_shots(paths, simulator_name)
    pieces, note = cut_long_recordings(shots.recordings)
    if not note:
        return shots
    simulator = shots.simulator
    if isinstance(simulator, RecordedSimulator):
        paths_by_piece = {piece.shot: simulator.paths[source] for source, piece in pieces}
        simulator = RecordedSimulator(simulator.joints, paths_by_piece)
    return MechanismShots(
        simulator,
        tuple(piece for _, piece in pieces),
        {piece.shot: shots.histories[source] for source, piece in pieces},
        (*shots.notes, note),
        {piece.shot: f"{shots.origins[source]}, {describe_times(piece)}" for source, piece in pieces},
    )


def _read_shots(paths: Sequence[Path], simulator_name: str) -> MechanismShots:
    """Read recordings as they are."""
    tables = [_read_table(path) for path in paths]
    place = Path(simulator_name)
    if place.suffix.lower() in (".xml", ".urdf"):
        file = read_mujoco_file(place)
        shots = _match_shots(tables, file)
        return replace(shots, simulator=file.find_touching(_sample_poses(shots)))
    if place.is_file() or is_ros_recording(place):
        return _pair_with_simulation(tables, separate_units(_read_table(place), frozenset()))
    if ":" not in simulator_name:
        raise OptionError(
            "--simulator takes FILE.xml of MuJoCo, MODULE:FUNCTION of Python, or a table of simulated positions; got"
            f" {escape_text(simulator_name)}"
        )
    numbered = separate_units(tables[0], frozenset())
    named = [one for one in name_joints(numbered) if NUMBERED_JOINT.fullmatch(one.name)]
    simulator = read_function(simulator_name, named)
    shots = _match_shots(tables, simulator)
    poses = _sample_poses(shots)
    poses = poses[:: max(len(poses) // _TRIED_STATES, 1)]
    simulator = try_function(simulator, np.concatenate([poses, 0 * poses], axis=1))
    name, notes = escape_text(simulator_name), list(shots.notes)
    if not simulator.takes_columns:
        notes.append(
            f"{name} takes one state at a time; a search takes many times as long as with a function of arrays that"
            " have a row per coordinate and a column per run"
        )
    if len(simulator.joints) > 1 and not simulator.takes_forces:
        notes.append(
            f"effects are tried as accelerations of single coordinates, since {name} takes no forces; where one joint"
            " carries another, give it a fourth parameter force, with forces and torques on its coordinates"
        )
    return replace(shots, simulator=simulator, notes=tuple(notes))


def _sample_poses(shots: MechanismShots) -> FloatArray:
    """Sample recorded poses (K, N) of all joints; one that is not observed is as the file of the simulator states."""
    joints, rest = [joint.name for joint in shots.simulator.joints], shots.simulator.rest[: len(shots.simulator.joints)]
    every = max(sum(len(one.t) for one in shots.recordings) // _MOST_POSES, 1)
    poses = []
    for one in shots.recordings:
        places = one.positions[::every, :, 0]
        pose = np.tile(rest, (len(places), 1))
        pose[:, [joints.index(name) for name in one.bodies]] = places
        poses.append(np.where(np.isfinite(pose), pose, rest))
    return np.concatenate(poses)


def _match_shots(tables: Sequence[TextTable], simulator: OutsideSimulator) -> MechanismShots:
    """Read the shots of all tables, numbered one after another."""
    recordings: list[Recording] = []
    histories, origins, notes = {}, {}, []
    familiar = frozenset(name.lower() for name in (*(joint.name for joint in simulator.joints), *simulator.inputs))
    for raw in tables:
        table = separate_units(raw, familiar)
        _require_numbers(table, familiar)
        joints, columns, assumed = _leave_out_far_turns(table, *find_joint_columns(table, simulator))
        inputs, more = find_input_columns(table, simulator, columns)
        unused = [name for name in table.columns if name not in {*columns, *inputs, *OTHER_COLUMNS}]
        jumping = set[str]()
        left = [f"{escape_text(table.path)}: not used: {', '.join(unused)}"] if unused else []
        silent = [name for name, column in zip(simulator.inputs, inputs, strict=True) if column is None]
        missing = [*(one.name for one in simulator.joints if one not in joints), *silent]
        doubts = [*_doubt_spelling(table, missing, unused), *_doubt_radians(table, joints, columns)]
        notes += [*table.notes, *assumed, *more, *left, *doubts]
        for part in _split_shots(table, simulator, joints, columns, inputs):
            shot = len(recordings)
            jumping |= _undo_full_turns(part, joints)
            recordings.append(_record(part, shot, joints))
            histories[shot] = InputHistory(part.t, part.inputs)
            origins[shot] = f"{table.path.name}, shot {part.number}"
        if jumping:
            angles = ", ".join(sorted(jumping))
            notes.append(f"{escape_text(table.path)}: jumps of a whole turn were undone in {angles}")
    if len({one.bodies for one in recordings}) > 1:
        raise OptionError("The recordings have columns for different joints; diagnose them separately")
    _require_samples(recordings)
    hidden = [joint.name for joint in simulator.joints if joint.name not in recordings[0].bodies]
    if hidden:
        notes.append(f"not recorded: {', '.join(hidden)}; every window starts near the rest of the simulator")
    if len({joint.unit for joint in simulator.joints if joint.name in recordings[0].bodies}) > 1:
        notes.append("some joints are in rad and others in m; in a common rms error, 1 mrad counts as much as 1 mm")
    return MechanismShots(simulator, tuple(recordings), histories, tuple(dict.fromkeys(notes)), origins)


def _require_numbers(table: TextTable, familiar: frozenset[str]) -> None:
    """Raise an OptionError where a column of text was left out that a joint or an input is called like."""
    for name in table.texts:
        match = WITH_UNIT.fullmatch(name)
        plain = match[1] if match else name
        if {name, plain} & familiar or NUMBERED_JOINT.fullmatch(plain) or NUMBERED_INPUT.fullmatch(plain):
            raise OptionError(
                f"{escape_text(table.path)}: the column {name} has values that are no numbers; write plain numbers, and"
                " leave a cell empty where there is none"
            )


def _doubt_spelling(table: TextTable, missing: Sequence[str], unused: Sequence[str]) -> list[str]:
    """List columns that are not used and nearly called like a joint or an input that has no column."""
    names = {one.lower(): one for one in missing}
    pairs = [(name, get_close_matches(name, names, 1, _ALIKE_NAMES)) for name in unused]
    return [
        f"{escape_text(table.path)}: {names[close[0]]} has no column; if it is {name}, give both the same name"
        for name, close in pairs
        if close
    ]


def _doubt_radians(table: TextTable, joints: Sequence[Joint], columns: Sequence[str]) -> list[str]:
    """List joints without stops that turn round, where no unit is stated."""
    doubts = []
    for joint, column in zip(joints, columns, strict=True):
        most = float(np.nanmax(np.abs(table.columns[column]), initial=0.0))
        if column not in table.units and joint.unit == "rad" and np.isinf(joint.limit) and most > 2 * np.pi:
            doubts.append(
                f"{escape_text(table.path)}: {column} goes up to {most:.3g} rad, more than a turn; if it is in degrees,"
                f" name the column {column} (deg)"
            )
    return doubts


def _leave_out_far_turns(
    table: TextTable, joints: tuple[Joint, ...], columns: list[str], notes: list[str]
) -> tuple[tuple[Joint, ...], list[str], list[str]]:
    """Leave out the turns of bodies that turn by half a turn: rotation vectors jump there.

    Raises:
        OptionError: Nothing else was recorded.
    """
    groups = {joint.body for joint in joints if joint.body and joint.unit == "rad"}
    for body in sorted(groups):
        turns = [_convert(table, joint, one) for joint, one in zip(joints, columns, strict=True) if joint.body == body]
        if np.nanmax(np.linalg.norm(turns, axis=0), initial=0.0) < _LARGEST_TURN:
            continue
        rest = [(joint, one) for joint, one in zip(joints, columns, strict=True) if joint.body != body]
        left = ", ".join(joint.name for joint in joints if joint.body == body)
        reason = f"{escape_text(table.path)}: {left} go beyond half a turn, where rotation vectors jump"
        if not rest:
            raise OptionError(f"{reason}; record shorter runs that begin near 0")
        joints, columns = tuple(joint for joint, _ in rest), [one for _, one in rest]
        notes = [*notes, reason]
    return joints, columns, notes


def _undo_full_turns(part: _Part, joints: tuple[Joint, ...]) -> set[str]:
    """Undo the jumps of angles that a sensor keeps within a turn, in place, and return the names of these joints."""
    jumping = set()
    for joint, column in zip(joints, part.positions.T, strict=True):
        rows = np.flatnonzero(np.isfinite(column))
        is_angle = joint.unit == "rad" and not joint.body and np.isinf(joint.limit)
        jumps = np.abs(np.diff(column[rows])).max(initial=0.0)
        if is_angle and _JUMP_SHARE * 2 * np.pi < jumps and np.ptp(column[rows]) < 1.01 * 2 * np.pi:
            column[rows] = np.unwrap(column[rows])
            jumping.add(joint.name)
    return jumping


def _require_samples(recordings: Sequence[Recording]) -> None:
    """Raise an OptionError where a joint has fewer values than any test needs."""
    counts = sum(one.is_observed.sum(axis=0) for one in recordings)
    for name, count in zip(recordings[0].bodies, counts, strict=True):
        if count < 2 * MIN_ROWS:
            raise OptionError(
                f"too few rows hold a time and a number for {name} to test anything: {count}; give {2 * MIN_ROWS} at"
                " least, better several hundred"
            )


def _pair_with_simulation(tables: Sequence[TextTable], simulated: TextTable) -> MechanismShots:
    """Pair recordings with the simulated positions of the same shots."""
    joints, place = name_joints(simulated), escape_text(simulated.path)
    names = [joint.name for joint in joints]
    everything = RecordedSimulator(joints, {0: (np.arange(2.0), np.zeros((2, len(joints))))})
    parts = {part.number: part for part in _split_shots(simulated, everything, joints, names, ())}
    if len(tables) > 1:
        raise OptionError("A table of simulated positions belongs to one recording; give one table of both")
    shots = _match_shots(tables, everything)
    numbers = [int(origin.rpartition(" ")[2]) for origin in shots.origins.values()]
    paths = {}
    for recording, number in zip(shots.recordings, numbers, strict=True):
        if number not in parts:
            raise OptionError(f"{place} lacks shot {number}; simulate every recorded shot")
        part = parts[number]
        sound = np.isfinite(part.positions).all(axis=1)
        t, positions = part.t[sound], part.positions[sound]
        if len(t) < 2 or t[0] > recording.t[0] or t[-1] < recording.t[-1]:
            raise OptionError(f"{place}: shot {number} does not cover the times of the recording")
        paths[recording.shot] = t, positions
    return replace(shots, simulator=RecordedSimulator(joints, paths))


def _read_table(path: Path) -> TextTable:
    """Read a table of any kind, with the names that its columns have there, but for time and shot."""
    if is_ros_recording(path):
        return read_ros_recording(path)
    if path.suffix.lower() != ".parquet":
        table = read_text_table(path, "A recording of a mechanism was expected")
    else:
        try:
            content = parquet.read_table(path)
        except (OSError, ArrowException) as error:
            raise OptionError(f"{escape_text(path)} is no whole Parquet file; export it again") from error
        table = name_columns(path, {name.lower(): content.column(name) for name in content.column_names}, {}, [])
    columns = dict(table.columns)
    for name, others in ALIASES.items():
        for other in others:
            if name in columns and other in columns:
                columns.pop(other if name in OTHER_COLUMNS else name)
    return replace(table, columns=columns, notes=tuple(one for one in table.notes if " is read as " not in one))


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
    table: TextTable,
    simulator: OutsideSimulator,
    joints: tuple[Joint, ...],
    columns: list[str],
    inputs: Sequence[str | None],
) -> list[_Part]:
    """Split the rows of a table into shots."""
    place = escape_text(table.path)
    table.require(["t"])
    t = table.columns["t"] * TIME_UNITS.get(table.units.get("t", "s"), 1.0)
    count = len(t)
    shots = table.columns.get("shot", np.zeros(count))
    positions = np.stack(
        [_convert(table, joint, column) for joint, column in zip(joints, columns, strict=True)], axis=1
    )
    positions[table.columns.get("observed", np.ones(count)) == 0] = np.nan
    given = [_convert_input(table, simulator, k, name) for k, name in enumerate(inputs)]
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


def _convert_input(table: TextTable, simulator: OutsideSimulator, number: int, column: str | None) -> FloatArray:
    """Return the values (T,) of an input; the position that a servo is asked for is in rad or m."""
    if column is None:
        return np.zeros(len(table.columns["t"]))
    servo = simulator.servo_joints[number]
    if servo >= 0:
        return _convert(table, simulator.joints[servo], column)
    unit = table.units.get(column)
    if unit in ANGLE_UNITS and unit != "rad":
        name = simulator.inputs[number]
        raise OptionError(
            f"{escape_text(table.path)}: {column} is in {unit}; {name} takes a force, or what its file says"
        )
    return np.asarray(table.columns[column], np.float64)


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
