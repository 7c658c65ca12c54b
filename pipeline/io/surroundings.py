"""What a track folder states to act on a body besides its scene: known inputs in tracks.csv, walls in scene.json.

Known inputs are columns of tracks.csv.

Between the samples an input is a spline. Forces and torques are stated over mass and moment of inertia, as only these
ratios follow from a motion. A platform or a pivot is stated by its position, whose second derivative acts: an error of
the stated position then shifts the predicted one by about as much, and does not grow with time.
Of the spin of a flight only the axis is an input: how strongly a spin lifts does not follow from its rate alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError
from scipy.interpolate import make_interp_spline

from models.core.errors import OptionError
from models.core.typing import FloatArray

# Inputs over mass (m/s^2) or moment of inertia (rad/s^2).
ACCELERATION_COLUMNS: Mapping[str, tuple[str, ...]] = {"slide": ("force_x", "force_y"), "pendulum": ("torque",)}
# Positions of what carries the bodies; those of a pivot are in m, those of a platform in the unit of x and y.
POSITION_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "slide": ("platform_x", "platform_y"),
    "pendulum": ("pivot_x", "pivot_y"),
}
# Spin axis of a flight in space; only its direction counts.
AXIS_COLUMNS = ("axis_x", "axis_y", "axis_z")
# Names by scene; no other column is an input.
INPUT_COLUMNS = {
    "slide": (*ACCELERATION_COLUMNS["slide"], *POSITION_COLUMNS["slide"]),
    "pendulum": (*ACCELERATION_COLUMNS["pendulum"], *POSITION_COLUMNS["pendulum"]),
    "flight": AXIS_COLUMNS,
}
# Values from here on, like NaN, count as missing.
_MAX_VALUE = 1e12


def find_input_columns(scene: str, coordinates: tuple[str, ...], names: Iterable[str], path: Path) -> tuple[str, ...]:
    """Find the columns that state known inputs.

    Args:
        scene: Scene of the folder.
        coordinates: Columns of its coordinates.
        names: Names of all columns.
        path: Their tracks.csv, for the message.

    Returns:
        Names of input columns of the scene.

    Raises:
        OptionError: A column is an input of another scene, or a spin axis or a space for it is incomplete.
    """
    own = INPUT_COLUMNS.get(scene, ())
    present = set(names)
    foreign = [name for columns in INPUT_COLUMNS.values() for name in columns if name in present and name not in own]
    if foreign:
        takes = f"takes the inputs {', '.join(own)}" if own else "takes no known inputs"
        raise OptionError(f"{path} has the column {foreign[0]}, but the scene {scene} {takes}; remove or rename it")
    inputs = tuple(name for name in own if name in present)
    if scene == "flight" and inputs and (inputs != AXIS_COLUMNS or len(coordinates) < len(AXIS_COLUMNS)):
        raise OptionError(f"{path}: a spin axis needs {', '.join(AXIS_COLUMNS)} beside x, y, z; complete or remove it")
    return inputs


def build_inputs(
    scene: str,
    columns: Mapping[str, FloatArray],
    t: FloatArray,
    ids: NDArray[np.str_],
    bodies: tuple[str, ...],
    rows: FloatArray,
    scale: float,
    place: str,
) -> FloatArray:
    """Build the inputs of one shot in the order in which the acceleration of its scene takes them.

    Args:
        scene: `slide`, `pendulum` or `flight`.
        columns: (K,) samples of each input column.
        t: (K,) s.
        ids: (K,) body of each sample.
        bodies: Names of N bodies.
        rows: (T,) s, times of the recording.
        scale: m per unit of a platform's position.
        place: File and shot, for the message.

    Returns:
        (T, N, I, 2) values and rates: of a slide the acceleration along x and y, of a pendulum that by the torque and
        those of the pivot, of a flight the spin axis.

    Raises:
        OptionError: A body has no sample of an input.
    """
    inputs = np.zeros((len(rows), len(bodies), 2 if scene == "slide" else 3, 2))
    if scene == "flight":
        length = np.linalg.norm(list(columns.values()), axis=0)
        columns = {name: values / np.where(length > 0, length, 1.0) for name, values in columns.items()}
    for name, values in columns.items():
        derivative = 2 if name in POSITION_COLUMNS.get(scene, ()) else 0
        # a platform that accelerates leaves a body behind: in its frame, the body accelerates backwards
        factor, k = (-scale if scene == "slide" and derivative else 1.0), _find_place(scene, name)
        for body, called in enumerate(bodies):
            own = (ids == called) & (np.abs(values) < _MAX_VALUE) & (np.abs(t) < _MAX_VALUE)
            if not own.any():
                raise OptionError(
                    f"{place}: {called} has no value of {name}; state it in every row, or drop the column"
                )
            inputs[:, body, k] += factor * _evaluate_spline(t[own], values[own], rows, derivative)
    return inputs


def _find_place(scene: str, name: str) -> int:
    """Return the place of a column among the inputs of its scene."""
    if scene == "slide":
        return ("x", "y").index(name[-1])
    return INPUT_COLUMNS[scene].index(name)


def _evaluate_spline(t: FloatArray, values: FloatArray, rows: FloatArray, derivative: int) -> FloatArray:
    """Return (T, 2): a derivative of a spline through samples (K,) and its rate; constant outside the samples.

    The second derivative of a spline of degree five is a cubic between samples, as integrators take it.
    """
    times, first = np.unique(t, return_index=True)
    degree = min(3 + derivative, 2 * (len(times) // 2) - 1)
    if degree <= derivative:
        return np.stack([np.full(len(rows), values[first[0]] if not derivative else 0.0), np.zeros(len(rows))], axis=1)
    spline = make_interp_spline(times, values[first], k=degree)
    inside: FloatArray = np.clip(rows, times[0], times[-1])
    rate = np.where(inside == rows, spline.derivative(derivative + 1)(inside), 0.0)
    return np.stack([spline.derivative(derivative)(inside) if derivative else spline(inside), rate], axis=1)


WALL_SPELLINGS = '[x0, y0, x1, y1], {"x": [x0, x1], "y": [y0, y1]} or {"length": ..., "width": ...}, in metres'
# Lower and upper limit along x and along y, m.
Limits = tuple[tuple[float, float], tuple[float, float]]


def parse_walls(value: Any) -> Limits | None:
    """Parse the walls of a scene.json.

    Args:
        value: One of `WALL_SPELLINGS`, or None.

    Returns:
        Limits along x and y, in increasing order; None where there are no walls.

    Raises:
        PydanticCustomError: The value is no rectangle.
    """
    if value is None:
        return None
    try:
        if isinstance(value, Mapping) and value.keys() >= {"x", "y"}:
            pairs = [list(map(float, value[name])) for name in ("x", "y")]
        elif isinstance(value, Mapping):
            pairs = [[0.0, float(value[name])] for name in ("length", "width")]
        else:
            x0, y0, x1, y1 = map(float, value)
            pairs = [[x0, x1], [y0, y1]]
        (x0, x1), (y0, y1) = map(sorted, pairs)
    except (KeyError, TypeError, ValueError):
        x0, x1, y0, y1 = [np.nan] * 4
    if not (np.isfinite([x0, x1, y0, y1]).all() and x0 < x1 and y0 < y1):
        raise PydanticCustomError("walls", "needs a rectangle as {spellings}", {"spellings": WALL_SPELLINGS})
    return (x0, x1), (y0, y1)


# Field of a scene.json.
WallsEntry = Annotated[Limits | None, BeforeValidator(parse_walls)]
