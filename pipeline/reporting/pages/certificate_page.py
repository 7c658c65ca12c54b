"""Pages of a table: certificate.html, and what the cushions of a learned profile do, with and without its network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from models.core.number_format import format_measured, format_value
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.table_learning.learned_table import LearnedTable, rebound_rolling_balls
from models.estimation.table_learning.table_measurements import MIN_CONTACTS_PER_CUSHION, MeasuredTable
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.contact_models import CUSHION_MODELS
from pipeline.engine.atomic_write import write_text
from pipeline.io.certificate_files import ADVISED_CONTACTS, ADVISED_SHOTS, NAMES, CertifiedTable, NumberComparison
from pipeline.io.table_profile import parse_learned_table
from pipeline.reporting.pages.page_template import embed_figure, pack_plotly_source, render_template

# Headings, and the numbers below each.
_SECTIONS = (
    ("Level", ("slope_x", "slope_y")),
    ("Cushions", ("restitution", "restitution_left", "restitution_right", "restitution_top", "restitution_bottom")),
    ("Cloth", ("roll_out", "rolling_friction", "sliding_friction")),
    ("Size and squareness", ("length", "width", "angle", "aspect")),
)
_RESTITUTION_CAPTION = (
    "Restitution of every cushion contact; diamonds: a ball that rolls at 1 m/s straight at the cushion"
)
# Directions of a positive and a negative slope, as on the plan: the table falls towards them.
FALLS = {"slope_x": ("to the right", "to the left"), "slope_y": ("to the bottom", "to the top")}
# What a number needs to be determined.
NEEDED = {
    **{f"restitution_{name}": f"{MIN_CONTACTS_PER_CUSHION} contacts with it" for name in CUSHIONS},
    "length": "a contact with the left and one with the right cushion",
    "width": "a contact with the top and one with the bottom cushion",
}
# px
_FIGURE_HEIGHT = 420


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
        repeatability=[
            (NAMES[name], *format_number("", entry), format_count(entry["count"], "shot"))  # a scatter has no direction
            for name, entry in document["repeatability"].items()
        ],
        figures=[
            ("Paths of all shots, and the fall of the table", embed_figure(slope, "plot-slope", 460)),
            (_RESTITUTION_CAPTION, embed_figure(restitution, "plot-restitution", _FIGURE_HEIGHT)),
            ("Roll-out by shot", embed_figure(by_shot, "plot-shots", _FIGURE_HEIGHT)),
        ],
        comparison=[_format_difference(row) for row in comparison],
        verdict=format_comparison(comparison, other) if comparison else "",
        other=other,
        law=certified.cushion_law,
        plotly=pack_plotly_source(),
    )  # fmt: skip
    write_text(path, html)


def _format_row(name: str, entry: dict[str, Any]) -> tuple[str, str, str, str, str]:
    """Format a number as a row of a table: words, value, standard deviation, unit, and what it is from."""
    unit = "contact" if name.startswith("restitution") or name in ("length", "width") else "shot"
    return NAMES[name], *format_number(name, entry), format_count(entry["count"], unit)


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


# Colours of the cushions in the order of `CUSHIONS`.
CUSHION_COLOURS = ("#0f5c42", "#c62828", "#1565c0", "#ef6c00")
# Length of the arrow of a slope of 1 mm/m, share of the table's width.
SLOPE_LENGTH = 0.35
# Longest arrow, share of the table's width.
MAX_ARROW = 0.45
# Standard deviations of a slope up to which a table counts as level: of the two slopes of a level table one exceeds
# them in one of forty cases.
LEVEL_SIGMAS = 2.5
# Marks of the ends of an arrow; plotly's own arrows lose their shaft where they are shorter than the head.
ARROW_MARKER = {
    "symbol": ["circle", "arrow"], "size": [6, 16], "angleref": "previous", "color": "#c62828", "opacity": 1,
}  # fmt: skip
MIDDLE_MARKER = {"symbol": "circle", "size": 6, "color": "#c62828"}
_SLOPES = ("slope_x", "slope_y")


def is_level(numbers: dict[str, Any]) -> bool:
    """Return whether no slope of a certificate exceeds its errors."""
    return all(abs(numbers[name]["value"]) < LEVEL_SIGMAS * numbers[name]["sigma"] for name in _SLOPES)


def build_slope_figure(numbers: dict[str, Any], tracks: Sequence[Tracks], table: Table) -> go.Figure:
    """Draw the paths of all shots, and the fall of the table as an arrow with its error.

    Args:
        numbers: Numbers of the certificate.
        tracks: Tracks of the shots.

    Returns:
        The figure; y runs down, as on the table.
    """
    figure = go.Figure()
    for k, one in enumerate(tracks):
        for ball in range(len(one.ids)):
            figure.add_scatter(
                x=one.xy[:, ball, 0], y=one.xy[:, ball, 1], mode="lines", line={"color": "#9aa5a0", "width": 1},
                name="paths", legendgroup="paths", showlegend=k == ball == 0, hoverinfo="skip",
            )  # fmt: skip
    corners = np.vstack([table.corners, table.corners[:1]])
    figure.add_scatter(
        x=corners[:, 0], y=corners[:, 1], mode="lines", line={"color": "#1b2420", "width": 2}, showlegend=False
    )
    slope = np.array([numbers[name]["value"] if numbers[name]["value"] is not None else np.nan for name in _SLOPES])
    if np.isfinite(slope).all():
        middle, size = table.corners.mean(axis=0), float(np.hypot(*slope))
        length = min(SLOPE_LENGTH * size, MAX_ARROW) * table.width
        end = middle + slope / max(size, 1e-9) * length
        sigma = [numbers[name]["sigma"] * length / max(size, 1e-9) for name in _SLOPES]
        angle = np.linspace(0, 2 * np.pi, 60)
        figure.add_scatter(
            x=end[0] + 2 * sigma[0] * np.cos(angle), y=end[1] + 2 * sigma[1] * np.sin(angle), mode="lines",
            fill="toself", line={"color": "#c62828", "width": 1}, fillcolor="rgba(198,40,40,0.18)",
            name="the fall, two standard deviations",
        )  # fmt: skip
        level = is_level(numbers)
        figure.add_scatter(
            x=[middle[0], end[0]], y=[middle[1], end[1]], mode="lines+markers", showlegend=False, hoverinfo="skip",
            line={"color": "#c62828", "width": 3}, marker=MIDDLE_MARKER if level else ARROW_MARKER,
        )  # fmt: skip
        text = "level within its errors" if level else f"falls {size:.2f} mm/m"
        figure.add_annotation(
            x=middle[0], y=min(middle[1], end[1]) - 2 * sigma[1], text=text, showarrow=False, yshift=14,
            bgcolor="rgba(255,255,255,0.85)", font={"color": "#c62828", "size": 14},
        )  # fmt: skip
    figure.update_xaxes(title="x (m)", constrain="domain", range=[-0.05, table.length + 0.05])
    figure.update_yaxes(title="y (m)", scaleanchor="x", range=[table.width + 0.05, -0.05])
    return figure


def build_restitution_figure(numbers: dict[str, Any], measured: MeasuredTable) -> go.Figure:
    """Draw the restitution of every contact over its speed, and of each cushion with two standard deviations.

    Args:
        numbers: Numbers of the certificate.
        measured: The measured table.

    Returns:
        The figure.
    """
    figure, contacts = go.Figure(), measured.contacts
    for k, (name, colour) in enumerate(zip(CUSHIONS, CUSHION_COLOURS, strict=True)):
        own = contacts.side == k
        figure.add_scatter(
            x=contacts.speed[own], y=contacts.restitution[own], mode="markers", name=name, legendgroup=name,
            marker={"color": colour, "size": 6, "opacity": 0.7},
        )  # fmt: skip
        entry = numbers[f"restitution_{name}"]
        if entry["value"] is not None:
            figure.add_scatter(
                x=[0.94 + 0.04 * k], y=[entry["value"]], mode="markers", name=name, legendgroup=name, showlegend=False,
                marker={"color": colour, "size": 11, "symbol": "diamond", "line": {"color": "white", "width": 1}},
                error_y={"type": "data", "array": [2 * entry["sigma"]], "color": colour, "thickness": 2},
            )  # fmt: skip
    figure.update_xaxes(title="speed into the cushion (m/s)", type="log", tickvals=[0.1, 0.2, 0.5, 1, 2, 5])
    figure.update_yaxes(title="restitution")
    return figure


def build_shot_figure(numbers: dict[str, Any], measured: MeasuredTable) -> go.Figure:
    """Draw the roll-out length that each shot gives alone, beside that of all.

    Args:
        numbers: Numbers of the certificate.
        measured: The measured table.

    Returns:
        The figure.
    """
    figure, entry, rows = go.Figure(), numbers["roll_out"], measured.rolling_by_shot
    number = 1 + np.arange(len(rows))
    figure.add_scatter(
        x=number, y=rows[:, 0], mode="markers", name="one shot alone", marker={"color": "#1565c0", "size": 8},
        error_y={"type": "data", "array": 2 * rows[:, 1], "color": "#1565c0"},
    )  # fmt: skip
    if entry["value"] is not None:
        low, high = (entry["value"] + side * 2 * entry["sigma"] for side in (-1, 1))
        edges = [0.5, len(rows) + 0.5]
        figure.add_scatter(
            x=[*edges, *edges[::-1]], y=[low, low, high, high], fill="toself", mode="lines", line={"width": 0},
            fillcolor="rgba(15,92,66,0.25)", name="all shots, two standard deviations",
        )  # fmt: skip
    figure.update_xaxes(title="shot", dtick=1 if len(rows) <= 15 else None)
    figure.update_yaxes(title="roll-out from 2 m/s (m)")
    return figure


# m/s and degrees from the normal of the ball, where they are not the axis; it rolls without side spin.
SPEED, DEGREES = 1.5, 35.0
_POINTS = 41
_AXES = (
    ("speed (m/s)", np.geomspace(0.2, 5.0, _POINTS)),
    ("angle of incidence from the normal (degrees)", np.linspace(0.0, 80.0, _POINTS)),
    ("side spin: surface speed over speed", np.linspace(-1.0, 1.0, _POINTS)),
)
# Colours and dashes of published models: where two agree, both are visible.
_STYLES = (("#9aa5a0", "dot"), ("#1565c0", "longdash"), ("#6a1b9a", "dot"), ("#ef6c00", "dot"))


def build_cushion_figure(learned: LearnedTable, table: Table) -> go.Figure:
    """Draw restitution and angle of departure of rolling balls over speed, angle and side spin.

    Args:
        learned: The learned table.
        table: Its dimensions.

    Returns:
        The learned model with and without its network, and published models with catalogue values.
    """
    figure = make_subplots(rows=2, cols=3, shared_xaxes="columns", vertical_spacing=0.06, horizontal_spacing=0.06)
    curves = []
    for law, (colour, dash) in zip(CUSHION_MODELS, cycle(_STYLES)):
        published = parse_learned_table(f'{{"effects": {{}}, "laws": {{"cushion": "{law}"}}}}')
        style = {"color": colour, "width": 1.4, "dash": dash}
        curves.append((f"{law}, catalogue values", published, style))
    plain = replace(learned, correction=NO_CORRECTION)
    curves.append((f"learned: {learned.cushion_law}", plain, {"color": "#0f5c42", "width": 2, "dash": "dash"}))
    if len(learned.correction):
        curves.append((f"learned: {learned.cushion_law} and network", learned, {"color": "#c62828", "width": 3}))
    for (name, model, style), (column, (title, grid)) in product(curves, enumerate(_AXES)):
        for row, values in enumerate(_evaluate_rebounds(model, column, grid, table)):
            figure.add_scatter(
                x=grid, y=values, name=name, legendgroup=name, showlegend=row + column == 0, mode="lines", line=style,
                row=row + 1, col=column + 1,
            )  # fmt: skip
        figure.update_xaxes(title=title, row=2, col=column + 1)
    figure.update_xaxes(type="log", tickvals=[0.2, 0.5, 1, 2, 5], col=1)
    figure.update_yaxes(title="restitution", row=1, col=1).update_yaxes(title="departure (degrees)", row=2, col=1)
    heading = (
        f"Rebounds of rolling balls: {SPEED:g} m/s, {DEGREES:g} degrees from the normal, no side spin, else as drawn"
    )
    return figure.update_layout(
        template="plotly_white", title=heading, height=760, legend={"orientation": "h", "y": -0.1}
    )


def write_cushion_page(learned: LearnedTable, table: Table, path: Path) -> None:
    """Write the figure as a page that needs no network, in one step.

    Args:
        learned: The learned table.
        table: Its dimensions.
        path: File to write.
    """
    html = build_cushion_figure(learned, table).to_html(include_plotlyjs=True, config={"displayModeBar": False})
    write_text(path, html)


def _evaluate_rebounds(
    learned: LearnedTable, column: int, grid: FloatArray, table: Table
) -> tuple[FloatArray, FloatArray]:
    """Return restitution and angle of departure (degrees) along one axis."""
    inputs = [np.full(_POINTS, SPEED), np.full(_POINTS, DEGREES), np.zeros(_POINTS)]
    inputs[column] = grid
    after = rebound_rolling_balls(learned, inputs[0], inputs[1], inputs[2], table.ball_radius, table.ball_mass)
    into = inputs[0] * np.cos(np.radians(inputs[1]))
    return -after[:, 0] / into, np.degrees(np.arctan2(after[:, 1], -after[:, 0]))
