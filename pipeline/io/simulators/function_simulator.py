"""A Python function as a simulator under diagnosis: `MODULE:FUNCTION`, (state, inputs, dt) -> state.

The state is an array of all positions, then all velocities. What the names of the columns of a recording leave open may
stand as attributes of the function: `coordinates`, `units`, `inputs`, `time_step`, its longest step in s, and
`velocity_lag`, the time in s by which its velocities lag behind its positions: half a step where it moves positions by
the new velocities (semi-implicit Euler), else 0.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
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
    units = _read_names(call, name, "units") or ("rad",) * len(coordinates)
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
    lag = getattr(call, "velocity_lag", 0.0)
    if not isinstance(lag, int | float) or not 0 <= lag <= step:
        raise OptionError(f"{name}.velocity_lag is a number of seconds from 0 to its time step; got {lag}")
    inputs = _read_names(call, name, "inputs")
    return FunctionSimulator(module, function, joints, inputs, float(step), float(lag))


def _read_names(call: object, name: str, attribute: str) -> tuple[str, ...]:
    """Read an attribute of a function that lists names; empty where it has none."""
    names = getattr(call, attribute, ())
    if not isinstance(names, tuple | list) or not all(isinstance(one, str) for one in names):
        raise OptionError(f'{name}.{attribute} is a tuple of names, ("elbow", ...); got {names!r}'[:200])
    return tuple(names)


def _format_reason(error: BaseException) -> str:
    """Format what a user's code raised on one line, with its kind."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]


def try_function(simulator: FunctionSimulator, state: FloatArray) -> None:
    """Raise an OptionError where a function cannot go one step from a state (2N,)."""
    inputs = len(simulator.inputs)
    try:
        after = simulator.step(state, np.zeros(inputs), np.zeros(len(state) // 2))
        if not np.isfinite(after).all():
            raise ValueError(f"from {state} it went to {after}")
    except (Exception, SystemExit) as error:  # a user's function may raise anything
        expected = f"(state of {len(state)} numbers, {inputs} inputs, dt) -> state"
        name = f"{simulator.module}:{simulator.function}"
        raise OptionError(f"{name} was called as {expected}; it failed: {_format_reason(error)}") from error


class FunctionSimulator:
    """A Python function; see `models.estimation.gap_scenes.outside_simulator.OutsideSimulator`."""

    takes_forces = False
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
    ) -> None:
        self.module, self.function = module, function
        self.joints, self.inputs, self.time_step, self.velocity_lag = joints, inputs, time_step, velocity_lag
        self.servo_joints = (-1,) * len(inputs)
        self.rest = np.zeros(2 * len(joints))
        self.failure = ""
        self._call = pkgutil.resolve_name(f"{module}:{function}")

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle the name of the function, which another process imports."""
        own = self.module, self.function, self.joints, self.inputs, self.time_step, self.velocity_lag
        return _import_again, (str(Path.cwd()), *own)

    def halve_step(self) -> FunctionSimulator:
        """Return the simulator with half its step."""
        step, lag = self.time_step / 2, self.velocity_lag / 2
        return FunctionSimulator(self.module, self.function, self.joints, self.inputs, step, lag)

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shots: IntArray, t: FloatArray
    ) -> FunctionRuns:
        """Begin runs side by side; see `OutsideSimulator.begin`."""
        return FunctionRuns(self, starts)

    def step(self, state: FloatArray, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Go on by a step from a state (2N,): the function, and then what changes the velocity beside it."""
        count, dt = len(self.joints), self.time_step
        after = np.asarray(self._call(state.copy(), inputs, dt), np.float64)
        if after.shape != state.shape:
            raise ValueError(f"a state of {len(state)} numbers was expected; the function returned {after.shape}")
        after[:count] += force * dt * dt / 2
        after[count:] += force * dt
        return after


class FunctionRuns:
    """Runs of a function; see `models.estimation.gap_scenes.outside_simulator.SimulatorRuns`."""

    def __init__(self, simulator: FunctionSimulator, starts: FloatArray) -> None:
        self._simulator, self._states = simulator, starts

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Let the runs go on by M steps."""
        paths = np.full((*inputs.shape[:2], self._states.shape[1]), np.nan)
        with redirect_stdout(sys.stderr):  # what a function prints is no result
            for state, given, push, path in zip(self._states, inputs, force, paths, strict=True):
                try:
                    for k, now in enumerate(given):
                        before = path[k - 1] if k else state
                        if not np.isfinite(before).all():
                            break
                        path[k] = self._simulator.step(before, now, push)
                except (Exception, SystemExit) as error:  # what a function cannot simulate is lost
                    self._simulator.failure = _format_reason(error)
        self._states = paths[:, -1]
        return paths


def _import_again(folder: str, *arguments: Any) -> FunctionSimulator:
    """Rebuild a simulator in another process."""
    if folder not in sys.path:
        sys.path.append(folder)
    return FunctionSimulator(*arguments)
