"""Files of `trueroll put-back`: where the balls lay, and what is missing to restore it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray
from models.estimation.ball_placement.ball_places import BallPlaces, measure_cushion_distances
from pipeline.engine.atomic_write import replace_file, write_json

SCHEMA = "trueroll.put-back/1"
COLUMNS = (
    "id", "kind", "x", "y", "sigma", "left_mm", "top_mm", "right_mm", "bottom_mm", "x_sigma_mm", "y_sigma_mm", "speed",
)  # fmt: skip


def describe_places(places: BallPlaces, place_sigma: FloatArray, table: Table, frame: float) -> dict[str, Any]:
    """Describe places as the content of put_back.json.

    Args:
        places: The N balls.
        place_sigma: Standard deviations (N, 2) of x and y relative to the noses, m, calibration included.
        table: The table.
        frame: Number of the frame.

    Returns:
        The content; distances are those of the centres of the balls.
    """
    distances = 1e3 * measure_cushion_distances(table, places.xy)
    balls = []
    for k, (name, kind) in enumerate(zip(places.ids, places.kinds, strict=True)):
        own = dict(zip(CUSHIONS, distances[k], strict=True))
        balls.append(
            {
                "id": name, "kind": kind, "x": _round_metres(places.xy[k, 0]), "y": _round_metres(places.xy[k, 1]),
                "sigma": _round_metres(places.sigma[k]),
                **{f"{side}_mm": round(float(own[side]), 2) for side in ("left", "top", "right", "bottom")},
                "x_sigma_mm": round(1e3 * float(place_sigma[k, 0]), 2),
                "y_sigma_mm": round(1e3 * float(place_sigma[k, 1]), 2),
                "speed": None if np.isnan(places.speed[k]) else round(float(places.speed[k]), 4),
            }
        )  # fmt: skip
    return {
        "schema": SCHEMA,
        "t": round(places.t, 6),
        "frame": round(frame, 3),
        "table": {"length": table.length, "width": table.width},
        "ball_radius": table.ball_radius,
        "balls": balls,
        "absent": list(places.absent),
    }


def write_places(document: dict[str, Any], folder: Path) -> None:
    """Write put_back.csv and put_back.json, each in one step.

    Args:
        document: Content of `describe_places`.
        folder: Folder of the files.
    """
    with replace_file(folder / "put_back.csv") as path, path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        rows.writeheader()
        rows.writerows(document["balls"])
    write_json(document, folder / "put_back.json")


def _round_metres(value: float) -> float:
    """Round to a hundredth of a millimetre."""
    return round(float(value), 5)
