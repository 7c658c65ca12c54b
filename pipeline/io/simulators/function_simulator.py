"""A Python function as a simulator under diagnosis: `MODULE:FUNCTION`, (state, inputs, dt[, force]) -> state.

The state is an array of all positions, then all velocities. Where it takes a `force`, that is an array of forces and
torques on the coordinates, N and N m: effects act as these do, also on what a joint carries; else they change the
velocities of single coordinates between the steps. What the names of the columns of a recording leave open may
stand as attributes of the function: `coordinates`, `units`, `inputs`, `time_step`, its longest step in s, and
`velocity_lag`, the time in s by which its velocities lag behind its positions. Where that is not stated, it is half a
step if the function moves positions by the new velocities (semi-implicit Euler), else 0.
"""

from __future__ import annotations

import inspect
import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.mechanism_inputs import EffectValues
from models.estimation.gap_scenes.outside_simulator import Drive, Joint

# s
_USUAL_TIME_STEP = 0.005


def read_function(name: str, columns: Sequence[Joint]) -> FunctionSimulator:
    """Import a function as a simulator.

    Args:
        name: `MODULE:FUNCTION`; the module may lie in the working directory.
        columns: Joints by the columns of a recording, where the function does not state its coordinates.

    Returns:
        The simulator.

    Raises:
        OptionError: It cannot be imported, or states something that cannot be used.
    """
    module, _, function = name.partition(":")
    if module == "__main__":
        raise OptionError("A function of __main__ cannot be imported by a helper process; write it into a file")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        call = pkgutil.resolve_name(name)
    except (Exception, SystemExit) as error:  # a user's module may raise anything
        reason = _format_reason(error)
        raise OptionError(f"A function MODULE:FUNCTION was expected; {name} cannot be imported: {reason}") from error
    if not callable(call):
        raise OptionError(f"A function MODULE:FUNCTION was expected; {name} is a {type(call).__name__}")
    coordinates = _read_names(call, name, "coordinates")
    units = _read_names(call, name, "units") or ("rad",)
    units = units * len(coordinates) if len(units) == 1 else units
    if not coordinates and not columns:
        raise OptionError(
            f'{name} has to state its coordinates: {function}.coordinates = ("elbow", ...), as the columns of the'
            " recording are named"
        )
    if len(units) != len(coordinates) or not set(units) <= {"rad", "m"}:
        raise OptionError(f"{name}.units has rad or m for each of {', '.join(coordinates)}; got {', '.join(units)}")
    joints = tuple(Joint(one, unit) for one, unit in zip(coordinates, units, strict=True)) or tuple(columns)
    step = getattr(call, "time_step", _USUAL_TIME_STEP)
    if not isinstance(step, int | float) or not 0 < step < float("inf"):
        raise OptionError(f"{name}.time_step is a number of seconds above 0; got {step}")
    lag = getattr(call, "velocity_lag", None)
    if lag is not None and (not isinstance(lag, int | float) or not 0 <= lag <= step):
        raise OptionError(f"{name}.velocity_lag is a number of seconds from 0 to its time step; got {lag}")
    inputs = _read_names(call, name, "inputs")
    return FunctionSimulator(module, function, joints, inputs, float(step), float(lag or 0), states_lag=lag is not None)


def _read_names(call: object, name: str, attribute: str) -> tuple[str, ...]:
    """Read an attribute of a function that lists names, or has one; empty where it has none."""
    names = getattr(call, attribute, ())
    names = (names,) if isinstance(names, str) else names
    if not isinstance(names, tuple | list) or not all(isinstance(one, str) for one in names):
        raise OptionError(f'{name}.{attribute} is a tuple of names, ("elbow", ...); got {names!r}'[:200])
    return tuple(names)


def _format_reason(error: BaseException) -> str:
    """Format what a user's code raised on one line, with its kind."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]


def try_function(simulator: FunctionSimulator, states: FloatArray) -> FunctionSimulator:
    """Try one step of a function from several states, one by one and all at once.

    Args:
        simulator: The function.
        states: (C, 2N) recorded states.

    Returns:
        The simulator, which steps many runs at once where the function can, with the inertias of its joints and the
        lag of its velocities.

    Raises:
        OptionError: The function cannot go one step from the first state, or takes forces that do not drive its joints.
    """
    with redirect_stdout(sys.stderr):  # what a function prints is no result
        return _try_steps(simulator, states)


def _try_steps(simulator: FunctionSimulator, states: FloatArray) -> FunctionSimulator:
    inputs, count = len(simulator.inputs), len(simulator.joints)
    nothing = np.zeros(inputs), np.zeros(count)
    try:
        after = simulator.step(states[0], *nothing)
        if not np.isfinite(after).all():
            raise ValueError(f"from {states[0]} it went to {after}")
    except (Exception, SystemExit) as error:  # a user's function may raise anything
        force = f", {count} forces" if simulator.takes_forces else ""
        expected = f"(state of {states.shape[1]} numbers, {inputs} inputs, dt{force}) -> state"
        name = f"{simulator.module}:{simulator.function}"
        raise OptionError(f"{name} was called as {expected}; it failed: {_format_reason(error)}") from error
    ends = np.full(states.shape, np.nan)
    ends[0] = after
    for state, end in zip(states[1:], ends[1:], strict=True):
        with suppress(Exception, SystemExit):  # what it cannot simulate is left out later, and said
            end[:] = simulator.step(state, *nothing)
    try:
        columns = [np.zeros((len(one), len(states))) for one in nothing]
        takes_columns = _is_same(simulator.step(states.T, *columns), ends.T)
    except (Exception, SystemExit):  # single states will do
        takes_columns = False
    usable = np.isfinite(ends).all(axis=1)
    states, ends = states[usable], ends[usable]
    joints = _measure_inertias(simulator, states, ends) if simulator.takes_forces else simulator.joints
    velocity, moved = ends[:, count:], ends[:, :count] - states[:, :count]
    lag = simulator.velocity_lag
    # where nothing accelerates, old and new velocities are the same
    moves_by_new = (velocity != states[:, count:]).any() and _is_same(moved, simulator.time_step * velocity)
    if moves_by_new and not simulator.states_lag:
        lag = simulator.time_step / 2
    return simulator.copy(joints=joints, takes_columns=takes_columns, velocity_lag=lag)


def _measure_inertias(simulator: FunctionSimulator, states: FloatArray, ends: FloatArray) -> tuple[Joint, ...]:
    """Return the joints with their inertias: a unit force over the mean acceleration that it adds.

    Args:
        simulator: The function.
        states: (C, 2N)
        ends: (C, 2N) states after a step without a force.

    Raises:
        OptionError: A force accelerates its own joint not at all, or backwards.
    """
    count, given = len(simulator.joints), np.zeros(len(simulator.inputs))
    added = np.zeros(count)
    for state, end in zip(states, ends, strict=True):
        for k, force in enumerate(np.eye(count)):
            added[k] += (simulator.step(state, given, force) - end)[count + k]
    accelerations = added / len(states) / simulator.time_step
    for joint, one in zip(simulator.joints, accelerations, strict=True):
        if not one > 0:  # also where it is not a number
            raise OptionError(
                f"{simulator.module}:{simulator.function} takes a force, but a force of 1 on {joint.name} adds an"
                f" acceleration of {one:.3g} to it; it has to be positive"
            )
    return tuple(
        replace(joint, inertia=float(1 / one)) for joint, one in zip(simulator.joints, accelerations, strict=True)
    )


# Relative and absolute difference of two steps from which they are not the same: rounding errors are far smaller, and
# differences that give derivatives are larger.
_SAME_STEP = 1e-9


def _is_same(one: FloatArray, other: FloatArray) -> bool:
    """Return whether two results of a step agree but for rounding errors, and are numbers at the same places."""
    is_near = np.abs(one - other) <= _SAME_STEP * (1 + np.abs(other))
    return bool((is_near | ~(np.isfinite(one) | np.isfinite(other))).all())


class FunctionSimulator:
    """A Python function; see `models.estimation.gap_scenes.outside_simulator.OutsideSimulator`."""

    last_mass = 1.0
    own_effects: Mapping[str, tuple[float, ...]] = MappingProxyType({})
    drives: tuple[Drive, ...] = ()

    def __init__(
        self,
        module: str,
        function: str,
        joints: tuple[Joint, ...],
        inputs: tuple[str, ...],
        time_step: float,
        velocity_lag: float,
        takes_columns: bool = False,
        states_lag: bool = False,
    ) -> None:
        """Take a function, what it states (its lag or not), and whether it steps C states at once, as columns."""
        self.module, self.function = module, function
        self.joints, self.inputs, self.time_step, self.velocity_lag = joints, inputs, time_step, velocity_lag
        self.takes_columns, self.states_lag = takes_columns, states_lag
        self.servo_joints = (-1,) * len(inputs)
        self.rest = np.zeros(2 * len(joints))
        self.failure = ""
        self._call = pkgutil.resolve_name(f"{module}:{function}")
        self.takes_forces = _takes_force(self._call)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle the name of the function, which another process imports."""
        return _import_again, (str(Path.cwd()), *self._arguments.values())

    @property
    def _arguments(self) -> dict[str, Any]:
        names = ("module", "function", "joints", "inputs", "time_step", "velocity_lag", "takes_columns", "states_lag")
        return {name: getattr(self, name) for name in names}

    @property
    def is_free_beside_others(self) -> bool:
        """Whether a run costs next to nothing where others are simulated beside it."""
        return self.takes_columns

    def halve_step(self) -> FunctionSimulator:
        """Return the simulator with half its step."""
        return self.copy(time_step=self.time_step / 2, velocity_lag=self.velocity_lag / 2)

    def copy(self, **changes: Any) -> FunctionSimulator:
        """Return the simulator with other arguments."""
        return FunctionSimulator(**{**self._arguments, **changes})

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shots: IntArray, t: FloatArray
    ) -> FunctionRuns:
        """Begin runs side by side; see `OutsideSimulator.begin`."""
        return FunctionRuns(self, starts)

    def step(self, state: FloatArray, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Go on by a step from a state (2N,) with inputs (I,) and, if it takes them, forces (N,); or from C of them.

        C states, inputs and forces are columns (2N, C), (I, C) and (N, C).
        """
        forces = (force.copy(),) if self.takes_forces else ()
        after = np.asarray(self._call(state.copy(), inputs.copy(), self.time_step, *forces), np.float64)
        if after.shape != state.shape:
            raise ValueError(f"a state of {len(state)} numbers was expected; the function returned {after.shape}")
        return after


# At every so many steps, one of the runs is stepped alone, too, and compared: that costs as much as a step of all.
_CHECK_EVERY = 8
# Runs that are stepped one by one in less time than as columns: 15 us each (a cart with a pole), all at once 45 us.
_FEW_RUNS = 2
# Runs from one that is compared to the next: those of different shots, as neighbours have nearly the same states.
_NEXT_RUN = 7919


class FunctionRuns:
    """Runs of a function; see `models.estimation.gap_scenes.outside_simulator.SimulatorRuns`."""

    def __init__(self, simulator: FunctionSimulator, starts: FloatArray) -> None:
        self._simulator, self._states, self._steps_done = simulator, starts, 0
        self._goes_together = simulator.takes_columns and len(starts) > _FEW_RUNS

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Let the runs go on by M steps: the function, and then what changes the velocity beside it."""
        with redirect_stdout(sys.stderr):  # what a function prints is no result
            paths = self._advance_together(inputs, force) if self._goes_together else None
            self._goes_together = paths is not None
            paths = self._advance_singly(inputs, force) if paths is None else paths
        paths[np.logical_or.accumulate(~np.isfinite(paths).all(axis=2), axis=1)] = np.nan
        self._states, self._steps_done = paths[:, -1], self._steps_done + inputs.shape[1]
        return paths

    def _find_pushes(self, force: FloatArray) -> FloatArray:
        """Find what forces (C, N) that a function does not take itself change in a step (C, 2N)."""
        dt = self._simulator.time_step
        pushes = np.concatenate([force * dt * dt / 2, force * dt], axis=1)
        return 0 * pushes if self._simulator.takes_forces else pushes

    def _advance_together(self, inputs: FloatArray, force: FloatArray) -> FloatArray | None:
        """Step C runs as the columns of one array; None where the function does not.

        A function of arrays needs about as long for hundreds of runs as for one. Another one raises, or mixes them up,
        perhaps only in some states: at every `_CHECK_EVERY`th step another run is compared with a step of its own.
        """
        now, push, given = self._states.T, self._find_pushes(force).T, inputs.transpose(1, 2, 0)
        force, step = force.T, self._simulator.step
        path = np.empty((len(given), *now.shape))
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
                for k, own in enumerate(given):
                    after = step(now, own, force)
                    turn, is_between = divmod(self._steps_done + k, _CHECK_EVERY)
                    one = turn * _NEXT_RUN % now.shape[1]
                    if not is_between and not _is_same(after[:, one], step(now[:, one], own[:, one], force[:, one])):
                        return None
                    now = path[k] = after + push
        except (Exception, SystemExit):  # of one of the runs, or of all
            return None
        return path.transpose(2, 0, 1)

    def _advance_singly(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Step each run alone; NaN from where it fails."""
        paths = np.full((*inputs.shape[:2], self._states.shape[1]), np.nan)
        pushes = self._find_pushes(force)
        for now, given, pull, push, path in zip(self._states, inputs, force, pushes, paths, strict=True):
            try:
                for k, own in enumerate(given):
                    if not np.isfinite(now).all():
                        break
                    now = path[k] = self._simulator.step(now, own, pull) + push
            except (Exception, SystemExit) as error:  # what a function cannot simulate is lost
                self._simulator.failure = _format_reason(error)
        return paths


def _takes_force(call: Callable[..., Any]) -> bool:
    """Return whether the fourth parameter of a function is called force."""
    try:
        names = tuple(inspect.signature(call).parameters)
    except (TypeError, ValueError):  # a compiled function may state none
        return False
    return len(names) > 3 and names[3] in ("force", "forces")


def _import_again(folder: str, *arguments: Any) -> FunctionSimulator:
    """Rebuild a simulator in another process."""
    if folder not in sys.path:
        sys.path.append(folder)
    return FunctionSimulator(*arguments)
