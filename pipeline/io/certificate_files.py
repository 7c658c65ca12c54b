"""Certificate of a table: its content, its file, and the comparison of two."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scipy.stats import norm

from models.core.errors import OptionError
from models.core.scene import Table
from models.core.tracks import Tracks
from models.estimation.table_learning.table_measurements import MeasuredTable, TableMeasurement

CERTIFICATE_FILE = "certificate.json"
SCHEMA = "trueroll.certificate/1"
# Shots and cushion contacts from which every cushion has enough contacts, and the scatter between shots is known to a
# third of itself.
ADVISED_SHOTS, ADVISED_CONTACTS = 6, 40
# Probability that any number of two equal tables is called different.
FALSE_ALARM = 0.01
# What each number is, in words.
NAMES: Mapping[str, str] = {
    "slope_x": "slope along the length", "slope_y": "slope along the width",
    "restitution": "restitution, all cushions", "restitution_left": "restitution, left cushion",
    "restitution_right": "restitution, right cushion", "restitution_top": "restitution, top cushion",
    "restitution_bottom": "restitution, bottom cushion", "roll_out": "roll-out from 2 m/s",
    "rolling_friction": "rolling friction", "sliding_friction": "sliding friction",
    "length": "length between the noses", "width": "width between the noses",
    "angle": "angle between long and short side", "aspect": "length over width in the image",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class CertifiedTable:
    """A certificate and what it rests on."""

    document: dict[str, Any]
    """Content of certificate.json."""
    sources: tuple[Path, ...]
    """Folders that were used, each clip once."""
    table: Table
    tracks: tuple[Tracks, ...]
    """Of every shot that was used."""
    cushion_law: str
    """Cushion model of greatest evidence."""
    measured: MeasuredTable


@dataclass(frozen=True, slots=True)
class NumberComparison:
    """One number of two certificates."""

    name: str
    unit: str
    first: float
    second: float
    sigma: float
    """Standard deviation of the difference."""
    differs: bool

    @property
    def difference(self) -> float:
        """Second minus first."""
        return self.second - self.first


def describe_certificate(
    table: Table,
    measured: MeasuredTable,
    shape: tuple[TableMeasurement, ...],
    shot_count: int,
    refusals: tuple[str, ...],
    potted: int,
) -> dict[str, Any]:
    """Describe a certificate as the content of certificate.json.

    Args:
        measured: Its numbers by the shots.
        shape: Its numbers by the calibration; empty without one.
        shot_count: Number of shots.
        refusals: Sentences on shots that could not be used.
        potted: Number of balls that fell into pockets.

    Returns:
        The content; `value` and `sigma` are null where the shots do not determine a number.
    """
    numbers = {one.name: _describe_measurement(one) for one in (*measured.measurements, *shape)}
    why = "the table has no pockets" if not table.pockets else (
        f"the jaws are not measured by the camera, and {potted} potted balls do not show how wide the openings are"
    )  # fmt: skip
    return {
        "schema": SCHEMA,
        "table": {"name": table.name, "length": table.length, "width": table.width, "pockets": table.pockets},
        "ball_radius": table.ball_radius,
        "shots": shot_count,
        "cushion_contacts": len(measured.contacts.excess),
        "numbers": numbers,
        "repeatability": {one.name: _describe_measurement(one) for one in measured.repeatability},
        "pocket_openings": {"observable": False, "why": why},
        "refused": list(refusals),
    }


def read_certificate(path: Path) -> dict[str, Any]:
    """Read a certificate.

    Args:
        path: A certificate.json, or the folder of one.

    Returns:
        Its content.

    Raises:
        OptionError: It is no certificate.
    """
    file = path / CERTIFICATE_FILE if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"its schema is {document['schema']!r}")
        for entry in document["numbers"].values():
            _ = entry["value"], entry["sigma"], entry["unit"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OptionError(f"--compare wants a certificate.json of trueroll certify; {file}: {error}") from error
    return dict(document)


def compare_certificates(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[NumberComparison, ...]:
    """Compare the numbers that both certificates state.

    A number differs if two measurements of equal tables would differ as much with a probability below `FALSE_ALARM`
    over the number of comparisons (Bonferroni).

    Args:
        first: Content of a certificate.
        second: Content of another one.

    Returns:
        The numbers in the order of the first certificate.
    """
    both = [
        (name, one, second["numbers"][name])
        for name, one in first["numbers"].items()
        if name in second["numbers"] and one["value"] is not None and second["numbers"][name]["value"] is not None
    ]
    limit = float(norm.isf(FALSE_ALARM / 2 / max(len(both), 1)))
    rows = []
    for name, one, other in both:
        sigma = math.hypot(one["sigma"], other["sigma"])
        differs = bool(abs(other["value"] - one["value"]) > limit * sigma)
        rows.append(NumberComparison(name, one["unit"], one["value"], other["value"], sigma, differs))
    return tuple(rows)


def describe_comparison(rows: tuple[NumberComparison, ...]) -> list[dict[str, Any]]:
    """Describe a comparison as JSON values."""
    return [asdict(row) | {"difference": row.difference} for row in rows]


def _describe_measurement(one: TableMeasurement) -> dict[str, Any]:
    is_known = math.isfinite(one.value) and math.isfinite(one.sigma)
    return {
        "value": one.value if is_known else None, "sigma": one.sigma if is_known else None, "unit": one.unit,
        "count": one.count,
    }  # fmt: skip
