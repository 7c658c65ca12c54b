"""Rows of dataclasses whose fields are all arrays with one row per object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from models.core.typing import BoolArray, IntArray

T = TypeVar("T")


def take_rows(whole: T, rows: IntArray | BoolArray) -> T:
    """Select rows.

    Args:
        whole: Dataclass of arrays (K, ...).
        rows: Indices (n,) or mask (K,).

    Returns:
        The same dataclass with those rows.
    """
    return type(whole)(*(getattr(whole, name)[rows] for name in _field_names(whole)))


def replace_rows(whole: T, rows: IntArray | BoolArray, part: T) -> T:
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


def concatenate_rows(parts: Sequence[T]) -> T:
    """Concatenate dataclasses of arrays.

    Args:
        parts: At least one, all of the same class.

    Returns:
        Their rows in that order.
    """
    names = _field_names(parts[0])
    return type(parts[0])(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _field_names(whole: object) -> list[str]:
    return [field.name for field in fields(whole)]  # type: ignore[arg-type]
