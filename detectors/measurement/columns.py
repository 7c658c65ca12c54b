"""Things kept as a dataclass of arrays, a row each."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


def with_rows(whole: T, rows: NDArray[np.int64] | NDArray[np.bool_], part: T) -> T:
    """A dataclass of arrays (K, ...) with some of its rows replaced by those of another."""
    made: dict[str, Any] = {}
    for name in (field.name for field in fields(whole)):  # type: ignore[arg-type]
        made[name] = getattr(whole, name).copy()
        made[name][rows] = getattr(part, name)
    return type(whole)(**made)
