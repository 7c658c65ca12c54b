"""A Python function as a simulator under diagnosis: `MODULE:FUNCTION`, (state, inputs, dt) -> state.

The state is an array of all positions, then all velocities. What the names of the columns of a recording leave open may
stand as attributes of the function: `coordinates`, `units`, `inputs`, and `time_step`, its longest step in s.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.outside_simulator import Drive, EffectValues, Joint

# s
_USUAL_TIME_STEP = 0.005
# What a function raises where it cannot simulate.
_FAULTS = (ArithmeticError, ValueError, RuntimeError)


def read_function(name: str, columns: Sequence[str], units: Mapping[str, str]) -> FunctionSimulator:
    """Import a function as a simulator.

    Args:
        name: `MODULE:FUNCTION`; the module may lie in the working directory.
        columns: Names of the columns of a recording that may be coordinates, where the function does not state them.
        units: Units of columns, rad by default.

    Returns:
        The simulator.

    Raises:
        OptionError: It cannot be imported, or states something that cannot be used.
    """
    module, _, function = name.partition(":")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        call = pkgutil.resolve_name(name)
    except Exception as error:  # a user's module may raise anything
        raise OptionError(f"A function MODULE:FUNCTION was expected; {name} cannot be imported: {error}") from error
    coordinates = tuple(getattr(call, "coordinates", columns))
    stated = dict(zip(coordinates, getattr(call, "units", ()), strict=False))
    joints = tuple(Joint(one, stated.get(one, units.get(one, "rad"))) for one in coordinates)
    inputs = tuple(getattr(call, "inputs", ()))
    simulator = FunctionSimulator(module, function, joints, inputs, float(getattr(call, "time_step", _USUAL_TIME_STEP)))
    _try_function(simulator, name)
    return simulator


def _try_function(simulator: FunctionSimulator, name: str) -> None:
    """Raise an OptionError where a function cannot go one step from rest."""
    count = len(simulator.joints)
    try:
        simulator.step(np.zeros(2 * count), np.zeros(len(simulator.inputs)), np.zeros(count), np.zeros(count))
    except Exception as error:  # a user's function may raise anything
        expected = f"(state of {2 * count} numbers, {len(simulator.inputs)} inputs, dt) -> state"
        raise OptionError(f"{name} was called as {expected}; it failed: {error}") from error


class FunctionSimulator:
    """A Python function; see `models.estimation.gap_scenes.outside_simulator.OutsideSimulator`."""

    takes_forces = False
    moving_mass = 1.0
    drives: tuple[Drive, ...] = ()

    def __init__(
        self, module: str, function: str, joints: tuple[Joint, ...], inputs: tuple[str, ...], time_step: float
    ) -> None:
        self.module, self.function = module, function
        self.joints, self.inputs, self.time_step = joints, inputs, time_step
        self.servo_joints = (-1,) * len(inputs)
        self.own_effects: dict[str, tuple[float, ...]] = {"armature": (0.0,) * len(joints)}
        self._call = pkgutil.resolve_name(f"{module}:{function}")

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle the name of the function, which another process imports."""
        return _import_again, (str(Path.cwd()), self.module, self.function, self.joints, self.inputs, self.time_step)

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shot: int, t: float
    ) -> FunctionRuns:
        """Begin runs side by side; see `OutsideSimulator.begin`."""
        none = (np.zeros(len(self.joints)),)
        return FunctionRuns(self, starts, np.array([own.get("armature", none)[0] for own in values]))

    def step(self, state: FloatArray, inputs: FloatArray, force: FloatArray, armature: FloatArray) -> FloatArray:
        """Go on by a step from a state (2N,): the function, and then what changes the velocity beside it."""
        count, dt = len(self.joints), self.time_step
        after = np.asarray(self._call(state.copy(), inputs, dt), np.float64)
        if after.shape != state.shape:
            raise ValueError(f"a state of {len(state)} numbers was expected; the function returned {after.shape}")
        change = (after[count:] - state[count:] + force * dt) / (1 + armature)
        # positions follow the change of velocity that the function does not know
        places = after[:count] + (state[count:] + change - after[count:]) * dt / 2
        return np.concatenate([places, state[count:] + change])


class FunctionRuns:
    """Runs of a function; see `models.estimation.gap_scenes.outside_simulator.SimulatorRuns`."""

    def __init__(self, simulator: FunctionSimulator, starts: FloatArray, armature: FloatArray) -> None:
        self._simulator, self._states, self._armature = simulator, starts, armature

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Let the runs go on by M steps."""
        paths = np.full((*inputs.shape[:2], self._states.shape[1]), np.nan)
        columns = zip(self._states, inputs, force, self._armature, paths, strict=True)
        for state, given, push, armature, path in columns:
            with suppress(*_FAULTS):  # what a function cannot simulate is lost
                for k, now in enumerate(given):
                    state = path[k] = self._simulator.step(state, now, push, armature)
        self._states = paths[:, -1]
        return paths


def _import_again(folder: str, *arguments: Any) -> FunctionSimulator:
    """Rebuild a simulator in another process."""
    if folder not in sys.path:
        sys.path.append(folder)
    return FunctionSimulator(*arguments)
