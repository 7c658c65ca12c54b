"""certificate.html: the certificate of a table on one self-contained page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from models.core.scene import CUSHIONS
from models.estimation.table_learning.table_measurements import MIN_CONTACTS_PER_CUSHION
from pipeline.engine.atomic_write import replace_file
from pipeline.io.certificate_files import (
    ADVISED_CONTACTS,
    ADVISED_SHOTS,
    NAMES,
    CertifiedTable,
    NumberComparison,
)
from pipeline.reporting.figures.certificate_figures import (
    build_restitution_figure,
    build_shot_figure,
    build_slope_figure,
    is_level,
)
from pipeline.reporting.pages.page_template import embed_figure, read_plotly_source, render_template
from pipeline.reporting.text.number_format import format_measured, format_value

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
FALLS = {"slope_x": ("to the right", "to the left"), "slope_y": ("to the bottom", "to the top")}
"""Directions of a positive and a negative slope, as on the plan: the table falls towards them."""
NEEDED = {
    **{f"restitution_{name}": f"{MIN_CONTACTS_PER_CUSHION} contacts with it" for name in CUSHIONS},
    "length": "a contact with the left and one with the right cushion",
    "width": "a contact with the top and one with the bottom cushion",
}
"""What a number needs to be determined."""
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
        warning=format_too_few(document),
        sections=[(heading, [_format_row(name, numbers[name]) for name in names if name in numbers])
                  for heading, names in _SECTIONS],
        repeatability=[_format_scatter(name, entry) for name, entry in document["repeatability"].items()],
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


def _format_row(name: str, entry: dict[str, Any]) -> tuple[str, str, str, str, str]:
    """Format a number as a row of a table: words, value, standard deviation, unit, and what it is from."""
    unit = "contact" if name.startswith("restitution") or name in ("length", "width") else "shot"
    return NAMES[name], *format_number(name, entry), format_count(entry["count"], unit)


def _format_scatter(name: str, entry: dict[str, Any]) -> tuple[str, str, str, str, str]:
    """Format a scatter between shots as a row of a table; it has no direction."""
    return NAMES[name], *format_number("", entry), format_count(entry["count"], "shot")


def _format_difference(row: NumberComparison) -> tuple[str, str, str, str, str, str, bool]:
    """Format a compared number as a row of a table."""
    values = (format_measured(one, row.sigma)[0] for one in (row.first, row.second, row.difference))
    first, second, difference = (_name_direction(row.name, value) for value in values)
    return NAMES[row.name], first, second, difference, format_value(row.sigma, 2), row.unit, row.differs


def format_number(name: str, entry: dict[str, Any]) -> tuple[str, str, str]:
    """Format value, standard deviation and unit of a number.

    Args:
        name: Its name.
        entry: The number in a certificate.

    Returns:
        Three texts; for a number that the shots do not determine, what is missing, and a dash.
    """
    if entry["value"] is None:
        needed = NEEDED.get(name, "")
        return f"not determined{needed and f': needs {needed}'}", "–", entry["unit"]
    value, sigma = format_measured(entry["value"], entry["sigma"])
    return _name_direction(name, value), sigma, entry["unit"]


def _name_direction(name: str, value: str) -> str:
    """Name the direction of a slope instead of its sign."""
    if name not in FALLS or value == "0":
        return value
    return f"{value.removeprefix('-')} {FALLS[name][value.startswith('-')]}"


def format_count(count: int, what: str) -> str:
    """Format a number of things, such as `1 shot` or `5 contacts`."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def format_certificate(document: dict[str, Any]) -> str:
    """Format the most important numbers of a certificate as a sentence."""
    numbers = document["numbers"]
    parts = []
    slope = [numbers[name] for name in ("slope_x", "slope_y")]
    if all(one["value"] is not None for one in slope):
        size = (slope[0]["value"] ** 2 + slope[1]["value"] ** 2) ** 0.5
        level = is_level(numbers)
        parts.append("it is level within its errors" if level else f"it falls by {size:.2f} mm/m")
    if numbers["restitution"]["value"] is not None:
        value, sigma, _ = format_number("restitution", numbers["restitution"])
        parts.append(f"its cushions return {value} ± {sigma} of the speed")
    if numbers["roll_out"]["value"] is not None:
        value, sigma, _ = format_number("roll_out", numbers["roll_out"])
        parts.append(f"a ball of 2 m/s rolls {value} ± {sigma} m")
    sentence = "; ".join(parts) or "these shots determine none of its numbers"
    shots = format_count(document["shots"], "shot")
    contacts = format_count(document["cushion_contacts"], "cushion contact")
    return f"{shots} with {contacts} on this table: {sentence}."


def format_too_few(document: dict[str, Any]) -> str:
    """Format that a certificate rests on too little, as a sentence; empty where it does not."""
    if document["shots"] >= ADVISED_SHOTS and document["cushion_contacts"] >= ADVISED_CONTACTS:
        return ""
    return (
        f"Too few for a certificate: {ADVISED_SHOTS} shots with some {ADVISED_CONTACTS} cushion contacts are advised."
        " With fewer, the scatter between shots is hardly known, and the errors below may be too small."
    )


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
