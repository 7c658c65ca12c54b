"""Tables of a session: one row per shot, as CSV and Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.core.shot_numbers import ShotNumbers
from models.estimation.shot_numbers.session_statistics import collect_session_numbers
from pipeline.io.csv_tables import Columns, write_columns


@dataclass(frozen=True, slots=True)
class SessionShot:
    """One shot of a session."""

    group: str
    folder: str
    """Run folder."""
    number: int
    """Number of the shot in the session, from 1."""
    shot: ShotNumbers


def tabulate_session(shots: Sequence[SessionShot]) -> Columns:
    """Arrange the shots of a session as columns.

    Args:
        shots: K shots.

    Returns:
        Columns (K,): texts, then for every number its value and `NAME_sigma`; NaN where it is not observable.
    """
    entries = [collect_session_numbers(one.shot) for one in shots]
    columns: Columns = {
        "number": np.array([one.number for one in shots], np.int64),
        "group": [one.group for one in shots], "folder": [one.folder for one in shots],
        "t": np.array([one.shot.t for one in shots], np.float64),
        "cue": [one.shot.cue for one in shots], "first": [one.shot.first for one in shots],
        "spin_state": [one.shot.spin_state for one in shots],
        "potted": [_format_potted(one.shot) for one in shots],
    }  # fmt: skip
    for name in dict.fromkeys(name for entry in entries for name in entry):
        pairs = [entry.get(name, (np.nan, np.nan, "", False)) for entry in entries]
        for column, place in ((name, 0), (f"{name}_sigma", 1)):
            columns[column] = np.array([pair[place] if pair[3] else np.nan for pair in pairs], np.float64)
    return columns


def _format_potted(shot: ShotNumbers) -> str:
    return "; ".join(f"{ball} {pocket}" for ball, pocket in zip(shot.potted, shot.pockets, strict=True))


def write_session_tables(columns: Columns, table: Path, parquet: Path) -> None:
    """Write the columns of a session.

    Args:
        columns: Columns of `tabulate_session`.
        table: CSV file to write.
        parquet: Parquet file to write.
    """
    write_columns(columns, table, "needed")
    pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), parquet)
