"""Matching of the balls on a table with the places where they are wanted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.typing import FloatArray, IntArray

ANY_KIND = "ball"
"""Kind of a ball whose class is unknown; it matches every kind."""
DIFFERENT_COLOUR = 38.0
"""CIE chroma distance from which colours count as entirely different: half the median distance between two of the eight
colours of pool balls. Other light changes the colours of all balls alike."""


@dataclass(frozen=True, slots=True)
class PlaceMatches:
    """M pairs of wanted places and present balls."""

    wanted: IntArray
    """(M,) indices of wanted places."""
    present: IntArray
    """(M,) indices of present balls."""


def match_places(
    wanted: tuple[tuple[str, ...], FloatArray, FloatArray],
    present: tuple[tuple[str, ...], FloatArray, FloatArray],
    diameter: float,
) -> PlaceMatches:
    """Match present balls with wanted places by kind, colour and least total distance.

    Balls of different kinds match only where they overlap by place: there the class of one of them is wrong.

    Args:
        wanted: Kinds (N,), places (N, 2) m and colours (N, 3) CIE L*a*b* of the wanted places; NaN for an unknown
            colour.
        present: The same of the K present balls.
        diameter: m, of a ball.

    Returns:
        The pairs, in the order of the wanted places.
    """
    (kinds, xy, colour), (present_kinds, present_xy, present_colour) = wanted, present
    distance = np.linalg.norm(xy[:, None] - present_xy[None], axis=2)
    farthest = float(distance.max(initial=diameter)) + diameter
    chroma = np.linalg.norm(colour[:, None, 1:] - present_colour[None, :, 1:], axis=2)
    differs = np.array([[ANY_KIND not in (a, b) and a != b for b in present_kinds] for a in kinds], bool)
    differs = differs.reshape(distance.shape)
    colour_cost = np.clip(np.nan_to_num(chroma) / DIFFERENT_COLOUR, 0.0, 1.0) * farthest
    # A pair of different kinds costs more than any rearrangement of pairs of equal kinds.
    cost = distance + colour_cost + differs * 2.0 * farthest * (1 + min(distance.shape, default=0))
    rows, columns = linear_sum_assignment(cost)
    is_pair = ~differs[rows, columns] | (distance[rows, columns] <= diameter)
    return PlaceMatches(rows[is_pair].astype(np.int64), columns[is_pair].astype(np.int64))
