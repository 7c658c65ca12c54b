"""Who is given to whom, at the least cost altogether."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.numerics.jit import compiled


def assigned(cost: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows, ascending, and the column of each: every row of `cost` (n, m) has one of its own, or every column a row.

    The sum of their costs is the least. Shortest augmenting paths (Crouse 2016, doi:10.1109/TAES.2016.140952); of
    equal sums the one that scipy gives, whose import takes longer than all assignments of a clip. ValueError where a
    cost is NaN or minus infinity, or infinite ones allow no assignment.
    """
    if np.isnan(cost).any() or np.isneginf(cost).any():
        raise ValueError("costs must be numbers above minus infinity")
    upright = cost.shape[0] <= cost.shape[1]
    column = _columns(np.ascontiguousarray(cost if upright else cost.T, dtype=np.float64))
    if len(column) and column[0] < 0:
        raise ValueError("infinite costs leave no assignment")
    if upright:
        return np.arange(len(column)), column
    rows = np.argsort(column)
    return column[rows], rows


@compiled
def _columns(cost: FloatArray) -> IntArray:
    """The column (n,) of each row of costs (n, m), n <= m; -1 where there is none."""
    n, m = cost.shape
    row_price, column_price = np.zeros(n), np.zeros(m)
    column_of, row_of = np.full(n, -1), np.full(m, -1)
    came_from, remaining = np.full(m, -1), np.empty(m, np.int64)
    for fresh in range(n):
        reached, passed, shortest = np.zeros(n, np.bool_), np.zeros(m, np.bool_), np.full(m, np.inf)
        remaining[:] = np.arange(m - 1, -1, -1)  # so that equal costs give the diagonal
        left, row, sink, length = m, fresh, -1, 0.0
        while sink < 0:
            reached[row] = True
            nearest, lowest = -1, np.inf
            for k in range(left):
                column = remaining[k]
                way = length + cost[row, column] - row_price[row] - column_price[column]
                if way < shortest[column]:
                    came_from[column], shortest[column] = row, way
                if shortest[column] < lowest or (shortest[column] == lowest and row_of[column] < 0):
                    nearest, lowest = k, shortest[column]
            if lowest == np.inf:
                column_of[0] = -1
                return column_of
            length, column = lowest, remaining[nearest]
            passed[column] = True
            left -= 1
            remaining[nearest] = remaining[left]
            if row_of[column] < 0:
                sink = column
            else:
                row = row_of[column]
        row_price[fresh] += length
        for row in range(n):
            if reached[row] and row != fresh:
                row_price[row] += length - shortest[column_of[row]]
        for column in range(m):
            if passed[column]:
                column_price[column] -= length - shortest[column]
        column, row = sink, -1
        while row != fresh:  # along the path, each takes the column of the one before
            row = came_from[column]
            row_of[column] = row
            column_of[row], column = column, column_of[row]
    return column_of
