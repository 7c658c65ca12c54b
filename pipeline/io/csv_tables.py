"""Writing of tables as CSV: columns with rounded numbers, events, and states of balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from models.core.events import Events
from models.core.trajectory import State
from models.core.typing import FloatArray
from pipeline.engine.atomic_write import replace_file

Columns = dict[str, Sequence[str] | NDArray[Any]]

# Decimals of each column (m, s, px); other columns have six.
DECIMALS = {"x_px": 3, "y_px": 3, "radius_px": 2, "frame": 3, "xx": 12, "xy": 12, "yy": 12}
SHOT_NUMBER = 0


def write_events(events: Events, path: Path) -> None:
    """Write events.csv: one row per event, gaps in mm.

    Args:
        events: Events of the shot.
        path: File to write.
    """
    columns: Columns = {
        "shot": np.full(len(events), SHOT_NUMBER), "kind": list(events.kind), "t": events.t, "t_sigma": events.t_sigma,
        "frame": events.frame, "a": list(events.a), "b": list(events.b), "x": events.xy[:, 0], "y": events.xy[:, 1],
        "probability": events.probability, "gap_mm": 1000 * events.gap, "gap_mm_sigma": 1000 * events.gap_sigma,
        "speed": events.speed,
    }  # fmt: skip
    write_columns(columns, path)


def write_states(ids: tuple[str, ...], t: FloatArray, state: State, path: Path) -> None:
    """Write the states of balls, ball by ball; unknown positions have no row.

    Args:
        ids: Names of the N balls.
        t: Times (T,) s.
        state: States (T, N).
        path: File to write.
    """
    ball, row = np.nonzero(np.isfinite(state.xy[..., 0]).T) if len(ids) else (np.empty(0, int),) * 2
    columns: Columns = {"shot": np.full(len(row), SHOT_NUMBER), "t": t[row], "id": [ids[k] for k in ball]}
    for name, values in (
        ("x", state.xy[..., 0]), ("y", state.xy[..., 1]), ("vx", state.v[..., 0]), ("vy", state.v[..., 1]),
        ("wx", state.w[..., 0]), ("wy", state.w[..., 1]), ("wz", state.w[..., 2]),
        ("sigma", state.sigma), ("sigma_v", state.sigma_v),
    ):  # fmt: skip
        columns[name] = values[row, ball]
    write_columns(columns, path)


def write_columns(
    columns: Mapping[str, Sequence[str] | NDArray[Any]], path: Path, quoting: Literal["none", "needed"] = "none"
) -> None:
    """Write columns (K,) as CSV in one step, with rounded numbers and empty cells for NaN.

    Args:
        columns: Values by name.
        path: File to write.
        quoting: `needed` puts texts into quotes, which may then contain commas.
    """
    arrays = {}
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.dtype.kind == "f":
            rounded = np.round(values, DECIMALS.get(name, 6)) + 0.0
            arrays[name] = pa.array(rounded, mask=~np.isfinite(rounded))
        elif isinstance(values, np.ndarray):
            arrays[name] = pa.array(values)
        else:
            arrays[name] = pa.array(list(values), type=pa.string())
    with replace_file(path) as fresh:
        csv.write_csv(pa.table(arrays), fresh, csv.WriteOptions(quoting_style=quoting, quoting_header="none"))
