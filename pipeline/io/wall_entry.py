"""The `walls` of a scene.json: a rectangle in metres that reflects sliding bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from models.core.errors import OptionError
from models.core.recording import Recording

WALL_SPELLINGS = '[x0, y0, x1, y1], {"x": [x0, x1], "y": [y0, y1]} or {"length": ..., "width": ...}, in metres'
# Tolerated distance beyond a wall, in sides of the rectangle: wrong units give more.
_MAX_OVERSHOOT = 0.1
# Largest tolerated share of positions further outside.
_MAX_SHARE_OUTSIDE = 0.25
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


def find_centre_limits(
    walls: Limits, radius: float, recordings: Sequence[Recording], path: Path
) -> tuple[tuple[float, float], ...]:
    """Find the limits of the centre of a body between walls.

    Args:
        walls: Limits along x and y, m.
        radius: Radius of the body, m.
        recordings: Recordings with x and y, m.
        path: The scene.json, for messages.

    Returns:
        Lower and upper limit of x and of y, m.

    Raises:
        OptionError: The body does not fit between the walls, or many positions are outside them.
    """
    limits = tuple((low + radius, high - radius) for low, high in walls)
    if any(low >= high for low, high in limits):
        raise OptionError(f"{path}: a body of radius {radius:g} m does not fit between the walls; correct one of them")
    places = np.concatenate([one.positions[one.is_observed] for one in recordings])
    for axis, (low, high) in enumerate(limits):
        margin = _MAX_OVERSHOOT * (high - low)
        outside = (places[:, axis] < low - margin) | (places[:, axis] > high + margin)
        if outside.mean() > _MAX_SHARE_OUTSIDE:
            name = "xy"[axis]
            raise OptionError(
                f"{path}: {name} goes from {places[:, axis].min():.3g} to {places[:, axis].max():.3g} m, but the walls"
                f" keep it between {low:.3g} and {high:.3g} m; correct walls, radius or units"
            )
    return limits
