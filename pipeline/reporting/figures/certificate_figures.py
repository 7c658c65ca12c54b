"""Figures of a certificate: paths and slope on the plan, restitution by cushion and speed, scatter between shots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.estimation.table_learning.table_measurements import MeasuredTable

CUSHION_COLOURS = ("#0f5c42", "#c62828", "#1565c0", "#ef6c00")
"""Colours of the cushions in the order of `CUSHIONS`."""
SLOPE_LENGTH = 0.35
"""Length of the arrow of a slope of 1 mm/m, share of the table's width."""
MAX_ARROW = 0.45
"""Longest arrow, share of the table's width."""
LEVEL_SIGMAS = 2.5
"""Standard deviations of a slope up to which a table counts as level: of the two slopes of a level table one exceeds
them in one of forty cases."""
ARROW_MARKER = {
    "symbol": ["circle", "arrow"], "size": [6, 16], "angleref": "previous", "color": "#c62828", "opacity": 1,
}  # fmt: skip
"""Marks of the ends of an arrow; plotly's own arrows lose their shaft where they are shorter than the head."""
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
        table: The table.

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
