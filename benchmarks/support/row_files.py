"""Rows of a benchmark in a CSV file, one per case, so that an interrupted run can continue."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

# A frozen dataclass of int, float and str.
Row = TypeVar("Row")

_TYPES: dict[str, Callable[[str], Any]] = {"int": int, "float": float, "str": str}


def read_rows(path: Path | None, kind: type[Row]) -> list[Row]:
    """Read all rows; none where there is no file."""
    if path is None or not path.exists():
        return []
    types = {one.name: _TYPES[str(one.type)] for one in fields(kind)}  # type: ignore[arg-type]
    with path.open(newline="") as file:
        return [kind(**{name: types[name](value) for name, value in row.items()}) for row in csv.DictReader(file)]


def append_row(row: Any, path: Path | None) -> None:
    """Append one row, if there is a path."""
    if path is None:
        return
    fresh = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, [one.name for one in fields(row)], lineterminator="\n")
        if fresh:
            writer.writeheader()
        writer.writerow(asdict(row))
