"""certificate.html: the certificate of a table on one self-contained page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.engine.atomic_write import replace_file
from pipeline.io.tables.certificate_files import NAMES, CertifiedTable, NumberComparison
from pipeline.reporting.figures.certificate_figures import (
    build_restitution_figure,
    build_shot_figure,
    build_slope_figure,
)
from pipeline.reporting.pages.page_template import embed_figure, read_plotly_source, render_template

_SECTIONS = (
    ("Level", ("slope_x", "slope_y")),
    ("Cushions", ("restitution", "restitution_left", "restitution_right", "restitution_top", "restitution_bottom")),
    ("Cloth", ("roll_out", "rolling_friction", "sliding_friction")),
    ("Size and squareness", ("length", "width", "angle", "aspect")),
)
"""Headings, and the numbers below each."""
_RESTITUTION_CAPTION = (
    "Restitution of every cushion contact; diamonds: a ball that rolls at 1 m/s straight at the cushion"
)
_FIGURE_HEIGHT = 420
"""px"""


def write_certificate_page(
    certified: CertifiedTable, title: str, path: Path, comparison: Sequence[NumberComparison] = (), other: str = ""
) -> None:
    """Write the page of a certificate, in one step.

    Args:
        certified: The certificate.
        title: Heading of the page.
        path: File to write.
        comparison: Numbers beside those of another certificate; empty for none.
        other: Name of the other certificate.
    """
    document, numbers = certified.document, certified.document["numbers"]
    slope = build_slope_figure(numbers, certified.tracks, certified.table)
    restitution = build_restitution_figure(numbers, certified.measured)
    by_shot = build_shot_figure(numbers, certified.measured)
    html = render_template(
        "certificate.html",
        name=title,
        document=document,
        sentence=format_certificate(document),
        sections=[(heading, [_format_row(name, numbers[name]) for name in names if name in numbers])
                  for heading, names in _SECTIONS],
        repeatability=[_format_row(name, entry) for name, entry in document["repeatability"].items()],
        figures=[
            ("Paths of all shots, and the fall of the table", embed_figure(slope, "plot-slope", 460)),
            (_RESTITUTION_CAPTION, embed_figure(restitution, "plot-restitution", _FIGURE_HEIGHT)),
            ("Roll-out by shot", embed_figure(by_shot, "plot-shots", _FIGURE_HEIGHT)),
        ],
        comparison=[_format_difference(row) for row in comparison],
        verdict=format_comparison(comparison, other) if comparison else "",
        other=other,
        law=certified.cushion_law,
        plotly=read_plotly_source(),
    )  # fmt: skip
    with replace_file(path) as target:
        target.write_text(html, encoding="utf-8")


def _format_row(name: str, entry: dict[str, Any]) -> tuple[str, str, str, str, int]:
    """Format a number as a row of a table."""
    return NAMES[name], *format_number(entry), entry["count"]


def _format_difference(row: NumberComparison) -> tuple[str, str, str, str, str, str, bool]:
    """Format a compared number as a row of a table."""
    values = f"{row.first:.4g}", f"{row.second:.4g}", f"{row.difference:+.2g}", f"{row.sigma:.2g}"
    return NAMES[row.name], *values, row.unit, row.differs


def format_number(entry: dict[str, Any]) -> tuple[str, str, str]:
    """Format value, standard deviation and unit of a number.

    Args:
        entry: The number in a certificate.

    Returns:
        Three texts; those of a number that the shots do not determine are dashes.
    """
    if entry["value"] is None:
        return "not determined", "–", entry["unit"]
    decimals = max(0, min(5, 1 - _find_order(entry["sigma"])))
    return f"{entry['value']:.{decimals}f}", f"{entry['sigma']:.{decimals}f}", entry["unit"]


def _find_order(value: float) -> int:
    """Return the power of ten of a positive value."""
    return int(f"{max(value, 1e-12):e}".partition("e")[2])


def format_certificate(document: dict[str, Any]) -> str:
    """Format the most important numbers of a certificate as a sentence."""
    numbers = document["numbers"]
    parts = []
    slope = [numbers[name] for name in ("slope_x", "slope_y")]
    if all(one["value"] is not None for one in slope):
        size = (slope[0]["value"] ** 2 + slope[1]["value"] ** 2) ** 0.5
        level = max(abs(one["value"]) / one["sigma"] for one in slope) < 2.5
        parts.append("it is level within its errors" if level else f"it falls by {size:.2f} mm/m")
    if numbers["restitution"]["value"] is not None:
        value, sigma, _ = format_number(numbers["restitution"])
        parts.append(f"its cushions return {value} ± {sigma} of the speed")
    if numbers["roll_out"]["value"] is not None:
        value, sigma, _ = format_number(numbers["roll_out"])
        parts.append(f"a ball of 2 m/s rolls {value} ± {sigma} m")
    sentence = "; ".join(parts) or "these shots determine none of its numbers"
    return f"{document['shots']} shots with {document['cushion_contacts']} cushion contacts on this table: {sentence}."


def format_comparison(rows: Sequence[NumberComparison], other: str) -> str:
    """Format which numbers of two certificates differ, as a sentence.

    Args:
        rows: The comparison.
        other: Name of the other certificate.

    Returns:
        The sentence.
    """
    different = [NAMES[row.name] for row in rows if row.differs]
    if not different:
        return f"No number differs from {other} beyond its errors."
    return f"Beyond their errors these numbers differ from {other}: {'; '.join(different)}."
