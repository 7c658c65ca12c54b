"""Rows of dataclasses whose fields are all columns, arrays or tuples, with one entry per object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from itertools import chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
# Indices (n,), or a mask (K,) with n set places.
Rows = NDArray[np.int64] | NDArray[np.bool_]


def take_rows(whole: T, rows: Rows) -> T:
    """Select rows.

    Args:
        whole: Dataclass of columns of length K.
        rows: Indices (n,) or mask (K,).

    Returns:
        The same dataclass with those rows.
    """
    return type(whole)(*(_take(getattr(whole, name), rows) for name in _field_names(whole)))


def replace_rows(whole: T, rows: Rows, part: T) -> T:
    """Replace some rows.

    Args:
        whole: Dataclass of arrays (K, ...).
        rows: Indices (n,) or mask (K,) with n set places.
        part: Dataclass of arrays (n, ...).

    Returns:
        A copy of `whole` with those rows taken from `part`.
    """
    columns: list[Any] = []
    for name in _field_names(whole):
        columns.append(getattr(whole, name).copy())
        columns[-1][rows] = getattr(part, name)
    return type(whole)(*columns)


def concatenate_rows(parts: Sequence[T], order: NDArray[np.int64] | None = None) -> T:
    """Concatenate dataclasses of columns.

    Args:
        parts: At least one, all of the same class.
        order: Rows of all parts together in the order of the result; None for the order of the parts.

    Returns:
        Their rows in that order.
    """
    columns = [_join([getattr(part, name) for part in parts]) for name in _field_names(parts[0])]
    return type(parts[0])(*(columns if order is None else (_take(column, order) for column in columns)))


def _take(column: Any, rows: Rows) -> Any:
    """Select entries of an array or a tuple."""
    if isinstance(column, tuple):
        return tuple(column[k] for k in np.arange(len(column))[rows])
    return column[rows]


def _join(columns: list[Any]) -> Any:
    """Join arrays, or tuples."""
    return tuple(chain.from_iterable(columns)) if isinstance(columns[0], tuple) else np.concatenate(columns)


def _field_names(whole: object) -> list[str]:
    return [field.name for field in fields(whole)]  # type: ignore[arg-type]
