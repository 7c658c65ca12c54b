"""Figures of a rally: the court from above and from the side, with flights, hits and landings."""

from __future__ import annotations

from typing import Literal

import numpy as np
import plotly.graph_objects as go

from models.core.ball_look import format_colour
from models.core.number_format import format_flight_speed
from models.core.rally import Rally
from models.core.typing import FloatArray
from models.estimation.rally.rally_views import evaluate_rally
from models.estimation.rally.stroke_summary import Stroke
from pipeline.reporting.text.stroke_sentences import format_stroke_end
from video.drawing.court_plan import MARGIN_SHARE, SIDE_COLOURS, find_ellipse
from video.drawing.palette import darken_for_white

PLOT_HZ = 100.0
HOVER = "%{customdata[0]:.3f} s, %{customdata[1]:.1f} m/s<br>%{customdata[2]:.2f} m high<extra>%{meta} player</extra>"
LINE_COLOUR, FAINT_COLOUR, LANDING_COLOUR = "#4d5852", "#d8dedb", "#c2410c"
CourtView = Literal["above", "side"]


def build_court_figure(rally: Rally, strokes: tuple[Stroke, ...], view: CourtView) -> go.Figure:
    """Build the figure of all strokes on their court.

    Args:
        view: From above, with y down the figure where the camera stands behind an end; or from the side.

    Returns:
        The figure; x is along the court in both views, the nearer or left end on the left.
    """
    figure, sport = go.Figure(), rally.scene.sport
    across = 1 if view == "above" else 2
    margin = MARGIN_SHARE * sport.length
    for line in sport.lines if view == "above" else ():
        _add_line(figure, line.start, line.end, LINE_COLOUR, 1.5)
    middle, out = sport.length / 2, sport.net.overhang
    if view == "above":
        _add_line(figure, (middle, -out), (middle, sport.width + out), LINE_COLOUR, 3)
    else:
        _add_line(figure, (-margin, sport.floor), (sport.length + margin, sport.floor), FAINT_COLOUR, 2)
        _add_line(figure, (0, 0), (sport.length, 0), LINE_COLOUR, 3)
        _add_line(figure, (middle, 0), (middle, sport.net.height), LINE_COLOUR, 3)
    named = set[str]()
    for stroke in strokes:
        _add_stroke(figure, rally, stroke, across, stroke.hit.player not in named)
        named.add(stroke.hit.player)
    _add_landings(figure, rally, strokes, across)
    figure.update_xaxes(range=[-margin, sport.length + margin], title="along the court (m)", constrain="domain")
    if view == "side":
        apexes = [one.apex[2] for one in strokes if np.isfinite(one.apex[2])]
        span = [sport.floor - 0.02 * sport.length, max([2 * sport.net.height, *apexes]) + 0.05 * sport.length]
        return figure.update_yaxes(range=span, title="height (m)", scaleanchor="x", constrain="domain")
    span = [-margin / 2, sport.width + margin / 2]
    span = span if sport.is_filmed_from_side else span[::-1]
    return figure.update_yaxes(range=span, title="across (m)", scaleanchor="x", constrain="domain")


def _add_line(
    figure: go.Figure, start: tuple[float, float], end: tuple[float, float], colour: str, width: float
) -> None:
    """Add a line of the court."""
    ends = {"x0": start[0], "y0": start[1], "x1": end[0], "y1": end[1]}
    figure.add_shape(type="line", **ends, line={"color": colour, "width": width}, layer="below")


def _add_stroke(figure: go.Figure, rally: Rally, stroke: Stroke, across: int, is_named: bool) -> None:
    """Add the flights of a stroke and the hit that begins it."""
    t = np.append(np.arange(stroke.hit.t, stroke.end, 1 / PLOT_HZ), stroke.end)
    path = evaluate_rally(rally, t)
    who, colour = stroke.hit.player or "unknown", format_colour(darken_for_white(SIDE_COLOURS[stroke.hit.player]))
    hover = np.column_stack([t, np.linalg.norm(path.v, axis=1), path.xyz[:, 2]])
    figure.add_scatter(
        x=path.xyz[:, 0], y=path.xyz[:, across], mode="lines", name=f"{who} player", legendgroup=who, meta=who,
        showlegend=is_named, line={"color": colour, "width": 2}, customdata=hover, hovertemplate=HOVER,
    )  # fmt: skip
    text = f"hit at {stroke.hit.t:.3f} s, {format_flight_speed(stroke.hit.speed, stroke.hit.speed_sigma)}"
    figure.add_scatter(
        x=[stroke.hit.place[0]], y=[stroke.hit.place[across]], mode="markers", legendgroup=who, showlegend=False,
        marker={"color": colour, "size": 8}, text=[text], hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip


def _add_landings(figure: go.Figure, rally: Rally, strokes: tuple[Stroke, ...], across: int) -> None:
    """Add the places of landings with their ellipses of two standard deviations."""
    landed = [(one, one.call.landing) for one in strokes if one.call is not None and one.call.landing is not None]
    landed = [(one, landing) for one, landing in landed if landing.is_seen or one is strokes[-1]]
    for _, landing in landed:
        by = [0, across]
        outline: FloatArray = landing.place[by] + find_ellipse(landing.covariance[np.ix_(by, by)], 2.0)
        figure.add_scatter(
            x=outline[:, 0], y=outline[:, 1], mode="lines", showlegend=False, hoverinfo="skip",
            line={"color": LANDING_COLOUR, "width": 1}, legendgroup="landing",
        )  # fmt: skip
    if landed:
        figure.add_scatter(
            x=[one.place[0] for _, one in landed], y=[one.place[across] for _, one in landed], mode="markers",
            name="landing or bounce", legendgroup="landing", marker={"symbol": "x", "size": 8, "color": LANDING_COLOUR},
            text=[format_stroke_end(rally, one) for one, _ in landed], hovertemplate="%{text}<extra></extra>",
        )  # fmt: skip
