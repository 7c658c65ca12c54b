"""session.html: the shots of a session on one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from models.core.fit_result import ShotNumber
from models.core.number_format import format_unit
from models.estimation.shot_numbers.session_statistics import SeriesSummary
from pipeline.io.csv_tables import Columns
from pipeline.reporting.pages.page_template import embed_figure, pack_plotly_source, render_template
from pipeline.reporting.text.number_sentences import (
    TIP_SHARE,
    format_direction,
    format_level,
    format_measurement,
    format_number,
    format_own_spread,
    format_spread,
    format_trend,
    name_number,
)
from pipeline.reporting.text.text_formatting import escape_text

# Numbers of the table of shots, as far as the session has them.
MAIN_NUMBERS = (
    "cue_speed", "direction", "top_spin_share", "side_spin_share", "contact_speed", "cut_angle", "throw", "deflection",
    "object_speed", "pocket_offset", "pocket_speed", "length", "object_length", "cushions",
)  # fmt: skip


def write_session_page(
    columns: Columns, summaries: Mapping[str, Sequence[SeriesSummary]], notes: Sequence[str], title: str, path: Path
) -> None:
    """Write the page of a session.

    Args:
        columns: One row per shot.
        summaries: Summaries of all numbers by group; those of the whole session under the empty name.
        notes: Sentences on folders that could not be read, or that count twice.
        title: Heading of the page.
        path: File to write.
    """
    groups = [name for name in summaries if name]
    owners = list(map(str, columns["group"]))
    in_table = {
        name: [one for one in some if one.count and one.name in MAIN_NUMBERS] for name, some in summaries.items()
    }
    shown = in_table[""]
    trends = (embed_figure(build_trend_figure(columns, one, groups), f"trend-{k}", 300) for k, one in enumerate(shown))
    has_tips = all(np.isfinite(np.asarray(columns.get(f"{name}_spin_share", []))).any() for name in ("side", "top"))
    html = render_template(
        "session.html",
        name=title,
        groups=[
            (escape_text(name), [_describe_summary(one, columns, name) for one in in_table[name]])
            for name in ("", *(name for name in groups if 1 < owners.count(name) < len(owners)))
        ],
        has_groups=owners != [Path(str(place)).name for place in columns["folder"]],
        headings=[name_number(one.name) for one in shown],
        shots=[_describe_shot(columns, row, shown) for row in range(len(columns["number"]))],
        figures=[(name_number(one.name), figure) for one, figure in zip(shown, trends, strict=True)],
        tips=embed_figure(build_tip_figure(columns, groups), "tips", 420) if has_tips else "",
        notes=list(notes),
        plotly=pack_plotly_source(),
    )  # fmt: skip
    path.write_text(html, encoding="utf-8")


def _describe_summary(one: SeriesSummary, columns: Columns, group: str) -> dict[str, str | bool | int]:
    """Describe a summary as a table row, of one group or, where its name is empty, of all shots."""
    owners = zip(columns["heading"], columns["group"], strict=True)
    headings = [heading for heading, owner in owners if group in ("", owner)]
    return {
        "name": name_number(one.name), "unit": format_unit(one.unit), "count": one.count,
        "median": format_level(one, headings), "spread": format_spread(one), "own": format_own_spread(one),
        "measurement": format_measurement(one), "has_trend": one.has_trend, "trend": format_trend(one),
    }  # fmt: skip


def _describe_shot(columns: Columns, row: int, shown: Sequence[SeriesSummary]) -> dict[str, object]:
    """Describe a shot as a table row."""
    return {
        "number": int(columns["number"][row]),
        "group": escape_text(str(columns["group"][row])),
        "folder": escape_text(Path(str(columns["folder"][row])).name),
        "first": columns["first_name"][row],
        "state": columns["spin_name"][row],
        "potted": columns["potted_names"][row],
        "cells": [_format_cell(columns, row, one) for one in shown],
    }


def _format_cell(columns: Columns, row: int, one: SeriesSummary) -> str:
    """Format a number of a shot as the report of its run does; empty where it is not observable."""
    number = ShotNumber(
        one.name, float(columns[one.name][row]), float(columns[f"{one.name}_sigma"][row]), one.unit, True
    )
    if not np.isfinite(number.value):
        return ""
    is_direction = one.name == "direction"
    return format_direction(number, str(columns["heading"][row])) if is_direction else format_number(number)


# Colours of the groups, dark enough on white.
GROUP_COLOURS = ("#0f5c42", "#b45309", "#1d4ed8", "#9d174d", "#4d7c0f", "#6d28d9", "#0e7490", "#7f1d1d")
# Offset, in radii, beyond which a tip slips off.
MAX_TIP_OFFSET = 0.5


def build_trend_figure(columns: Columns, summary: SeriesSummary, groups: Sequence[str]) -> go.Figure:
    """Build the figure of one number over the shots of a session, with its trend.

    Args:
        columns: Table of the session.
        summary: Summary of the number over all shots.
        groups: Names of the groups, in the order of their colours.

    Returns:
        The figure; bars are one standard deviation.
    """
    figure, x, name = go.Figure(), np.asarray(columns["number"], np.float64), summary.name
    values, sigmas = np.asarray(columns[name], np.float64), np.asarray(columns[f"{name}_sigma"], np.float64)
    label, level = format_unit(summary.unit), summary.median
    if name == "direction":
        values, label, level = (values - level + 180) % 360 - 180, "° to the right of the median", 0.0
    owners = np.array(columns["group"])
    for group, colour in zip(groups, cycle(GROUP_COLOURS), strict=False):
        rows = (owners == group) & np.isfinite(values)
        figure.add_scatter(
            x=x[rows], y=values[rows], error_y={"array": sigmas[rows], "thickness": 1, "width": 2}, mode="markers",
            name=group, legendgroup=group, showlegend=len(groups) > 1, marker={"color": colour, "size": 7},
            hovertemplate="shot %{x}: %{y:.3g}<extra>" + group + "</extra>",
        )  # fmt: skip
    if np.isfinite(summary.slope):
        shown = x[np.isfinite(values)]
        line = np.array([shown.min(), shown.max()])
        middle = float(np.median(shown))
        limits = ((slope, "dot", 1) for slope in (summary.slope_low, summary.slope_high))
        for slope, dash, width in ((summary.slope, "solid", 2), *limits):
            figure.add_scatter(
                x=line, y=level + slope * (line - middle), mode="lines", showlegend=False, hoverinfo="skip",
                line={"color": "#4d5852", "dash": dash, "width": width},
            )  # fmt: skip
    figure.update_xaxes(title="shot", rangemode="tozero", dtick=max(1, round(len(x) / 10)))
    figure.update_yaxes(title=label)
    return figure


def build_tip_figure(columns: Columns, groups: Sequence[str]) -> go.Figure:
    """Build the figure of where the tip met the cue ball, as its spin tells.

    Args:
        columns: Table of the session.
        groups: Names of the groups.

    Returns:
        The figure: the ball as the player sees it, in radii.
    """
    figure, owners = go.Figure(), np.array(columns["group"])
    side, top = (np.asarray(columns[name], np.float64) for name in ("side_spin_share", "top_spin_share"))
    for radius, dash in ((1.0, "solid"), (MAX_TIP_OFFSET, "dot")):
        figure.add_shape(
            type="circle", x0=-radius, y0=-radius, x1=radius, y1=radius, line={"color": "#4d5852", "dash": dash}
        )
    for group, colour in zip(groups, cycle(GROUP_COLOURS), strict=False):
        rows = (owners == group) & np.isfinite(side) & np.isfinite(top)
        figure.add_scatter(
            x=TIP_SHARE * side[rows], y=TIP_SHARE * top[rows], mode="markers", name=group, showlegend=len(groups) > 1,
            marker={"color": colour, "size": 9}, hovertemplate="right %{x:.2f} R, up %{y:.2f} R<extra></extra>",
        )  # fmt: skip
    figure.update_xaxes(title="to the right (radii)", range=[-1.1, 1.1])
    figure.update_yaxes(title="above the centre (radii)", range=[-1.1, 1.1], scaleanchor="x")
    return figure
