"""Rows of a table of tracks, a row per body and time, as a grid of times and bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray


@dataclass(frozen=True, slots=True)
class RowGrid:
    """The places of K rows in a grid of T times and N bodies; of several rows in one place, the first counts."""

    first: NDArray[np.intp]
    """(T,) first row of each time, ascending in time."""
    bodies: tuple[str, ...]
    place: NDArray[np.intp]
    """(M,) filled places, counted along the bodies of one time, then in time."""
    row: NDArray[np.intp]
    """(M,) the row of each."""

    def scatter(self, values: FloatArray) -> FloatArray:
        """Arrange values (K, ...) of rows as (T, N, ...), NaN where there is no row."""
        grid = np.full((len(self.first) * len(self.bodies), *values.shape[1:]), np.nan)
        grid[self.place] = values[self.row]
        return grid.reshape(len(self.first), len(self.bodies), *values.shape[1:])


def build_row_grid(times: NDArray[np.generic], names: NDArray[np.str_], bodies: Sequence[str] = ()) -> RowGrid:
    """Build the grid of rows.

    Args:
        times: (K,) frame or time of each row.
        names: (K,) body of each row.
        bodies: All names in the order of the grid; empty for that of their first rows.

    Returns:
        The grid.
    """
    _, first, time = np.unique(times, return_index=True, return_inverse=True)
    words = names.tolist()
    order = tuple(bodies or dict.fromkeys(words))
    number = {name: k for k, name in enumerate(order)}
    place, row = np.unique(time * len(order) + [number[name] for name in words], return_index=True)
    return RowGrid(first, order, place, row)
