"""Figures of a run: table from above, speeds, energies, and fitted parameters with their textbook ranges."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from models.core.ball_look import BallLook, format_colour
from models.core.fit_result import Fit, Parameter
from models.core.naming import Naming
from models.core.number_format import format_with_sigma
from models.core.scene import CUSHIONS, Scene
from models.core.trajectory import State
from models.core.typing import FloatArray
from models.estimation.forecast.forecast_values import ForecastErrors
from pipeline.reporting.figures.motion_samples import find_moving_balls, kinetic_energy
from pipeline.reporting.text.text_formatting import (
    TEXTBOOK_RANGES,
    format_event,
    format_event_time,
    format_parameter_name,
)
from video.drawing.palette import darken_for_white

PLOT_HZ = 60.0
HOVER_TEMPLATE = (
    "%{customdata[0]:.3f} s, %{customdata[1]:.2f} m/s<br>%{customdata[2]:.3f} m from the left"
    "<br>%{customdata[3]:.3f} m from the far side"
)
MARKED_KINDS = ("strike", "ball", "cushion", "pocket")
STRIPE_SYMBOL = "circle-dot"
# Height of the row of one parameter, px.
PARAMETER_ROW_PX = 92
# Margin of an axis, as a share of the range that is drawn on it.
AXIS_MARGIN = 0.15


def style_line(look: BallLook) -> dict[str, str]:
    """Style the line of a ball on a white page: light colours are darkened, and striped balls have dashes."""
    return {"color": format_colour(darken_for_white(look.colour)), "dash": "dash" if look.is_striped else "solid"}


def build_plan_figure(scene: Scene, fit: Fit, looks: Sequence[BallLook]) -> go.Figure:
    """Build the plan of the table with the fitted paths and the final positions of the balls.

    Args:
        scene: Table and camera.
        fit: The fit of N balls.
        looks: How they look.

    Returns:
        The figure, which lies as the table lies in the clip, with the names of its rails.
    """
    table, view = scene.table, fit.naming.view
    columns, rows = view.find_size(table)
    figure = go.Figure()
    figure.add_shape(type="rect", x0=0, y0=0, x1=columns, y1=rows, line={"color": "#4b6b5d", "width": 3})
    for x, y in view.turn_points(table.pocket_centres, table):
        r = 1.6 * table.ball_radius
        figure.add_shape(type="circle", x0=x - r, y0=y - r, x1=x + r, y1=y + r, fillcolor="#30343a", line_width=0)
    t = fit.trajectory.sample_times(PLOT_HZ)
    state = fit.trajectory.at(t)
    times = np.broadcast_to(t[:, None], state.xy.shape[:2])
    places = view.turn_points(state.xy, table)
    hover = np.concatenate([np.stack([times, np.linalg.norm(state.v, axis=-1)], axis=-1), places], axis=-1)
    moves = find_moving_balls(state.xy, table.ball_radius)
    for k, ball in enumerate(map(fit.naming.name_ball, fit.trajectory.ids)):
        there = np.flatnonzero(np.isfinite(state.xy[:, k, 0]))
        if not len(there):
            continue
        for shown, mode in ((there if moves[k] else there[:0], "lines"), (there[-1:], "markers")):
            figure.add_scatter(
                x=places[shown, k, 0], y=places[shown, k, 1], mode=mode, name=ball, legendgroup=ball,
                showlegend=mode == "markers", line=style_line(looks[k]),
                marker={"size": 10, "color": format_colour(looks[k].colour), "line": {"color": "#4b6b5d", "width": 1},
                        "symbol": STRIPE_SYMBOL if looks[k].is_striped else "circle"},
                customdata=hover[shown, k], hovertemplate=f"{HOVER_TEMPLATE}<extra>{ball}</extra>",
            )  # fmt: skip
    _add_contacts(figure, fit, view.turn_points(fit.events.xy, table))
    for cushion in CUSHIONS:
        side, along = view.name_rail(cushion), 0.25 if view.is_long(cushion) else 0.5  # beside the pocket in the middle
        x, y, angle = {
            "left": (0, along * rows, -90), "right": (columns, along * rows, 90), "far": (along * columns, 0, 0),
            "near": (along * columns, rows, 0),
        }[side]  # fmt: skip
        figure.add_annotation(
            text=fit.naming.name_rail(cushion), x=x, y=y, textangle=angle, showarrow=False,
            xshift=angle / 6, yshift={"far": 15, "near": -15}.get(side, 0),
        )  # fmt: skip
    rim = 0.04 * table.length
    figure.update_layout(margin={"l": 30, "r": 30, "t": 30, "b": 30})
    figure.update_yaxes(
        range=[rows + rim, -rim], scaleanchor="x", constrain="domain", constraintoward="top", visible=False
    )
    return figure.update_xaxes(range=[-rim, columns + rim], constrain="domain", visible=False)


def _add_contacts(figure: go.Figure, fit: Fit, places: FloatArray) -> None:
    """Mark strikes, contacts and pockets at their places on the plan (E, 2), m."""
    events = fit.events
    marked = [k for k in range(len(events)) if events.kind[k] in MARKED_KINDS]
    figure.add_scatter(
        x=places[marked, 0], y=places[marked, 1], mode="markers", name="contacts", customdata=marked,
        marker={"symbol": "x", "size": 9, "color": "#c2410c"},
        text=[f"{format_event_time(events, k)}<br>{format_event(events, k, fit.naming)}" for k in marked],
        hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip


def build_speed_figure(scene: Scene, fit: Fit, looks: Sequence[BallLook]) -> go.Figure:
    """Build the plot of the speed of every moving ball over the time of the source clip.

    Args:
        scene: Table and camera.
        fit: The fit of N balls.
        looks: How they look.

    Returns:
        The figure, in m/s.
    """
    figure = _build_time_figure(scene, fit, looks, lambda state: np.linalg.norm(state.v, axis=-1))
    return figure.update_yaxes(title="speed (m/s)", rangemode="tozero", hoverformat=".2f")


def build_energy_figure(scene: Scene, fit: Fit, looks: Sequence[BallLook]) -> go.Figure:
    """Build the plot of the kinetic energy of every moving ball and of their sum over the time of the source clip.

    Args:
        scene: Table and camera.
        fit: The fit of N balls.
        looks: How they look.

    Returns:
        The figure, in mJ.
    """
    figure = _build_time_figure(scene, fit, looks, lambda state: 1000 * kinetic_energy(state, scene.table), True)
    return figure.update_yaxes(title="energy (mJ)", rangemode="tozero", hoverformat=".1f")


def _build_time_figure(
    scene: Scene,
    fit: Fit,
    looks: Sequence[BallLook],
    evaluate: Callable[[State], FloatArray],
    has_sum: bool = False,
) -> go.Figure:
    """Build the plot of values (T, N) of the states of all balls, and of their sum, over time."""
    figure, t = go.Figure(), fit.trajectory.sample_times(PLOT_HZ)
    state = fit.trajectory.at(t)
    values, moves = evaluate(state), find_moving_balls(state.xy, scene.table.ball_radius)
    for k, ball in enumerate(map(fit.naming.name_ball, fit.trajectory.ids)):
        if moves[k]:
            figure.add_scatter(x=t, y=values[:, k], mode="lines", name=ball, line=style_line(looks[k]))
    if has_sum and moves.sum() > 1:
        whole = np.nansum(values[:, moves], axis=1)
        figure.add_scatter(x=t, y=whole, mode="lines", name="all balls", line={"color": "#1f4e9c", "dash": "dot"})
    line = {"width": 1, "dash": "dot", "color": "#9ca3af"}
    marks = [
        {"type": "line", "xref": "x", "yref": "y domain", "x0": when, "x1": when, "y0": 0, "y1": 1, "line": line}
        for when, kind in zip(fit.events.t.tolist(), fit.events.kind, strict=True)
        if kind in ("strike", "ball", "cushion")
    ]
    figure.update_layout(
        shapes=marks, hovermode="x"
    )  # all at once: plotly validates all shapes again whenever one is added
    return figure.update_xaxes(title="time of the clip (s)", hoverformat=".3f")


def build_forecast_figure(errors: ForecastErrors, naming: Naming) -> go.Figure:
    """Build a plot of the error of a prediction over time, and over the cushion contacts since its start.

    Args:
        errors: Comparison of the rest of a shot with its prediction.
        naming: What balls are called, and how they look.

    Returns:
        The figure, in mm.
    """
    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.04)
    balls = np.array(errors.ball)
    for ball in dict.fromkeys(errors.ball):
        rows = balls == ball
        error = 1000 * errors.error[rows]
        shown, line = {"name": naming.name_ball(ball), "legendgroup": ball}, style_line(naming.find_look(ball))
        figure.add_scatter(x=errors.seconds[rows], y=error, mode="lines", line=line, row=1, col=1, **shown)
        counts = np.unique(errors.cushions[rows])
        median = [float(np.median(error[errors.cushions[rows] == count])) for count in counts]
        figure.add_scatter(
            x=counts, y=median, mode="markers", marker={"color": line["color"], "size": 10}, row=1, col=2,
            showlegend=False, **shown,
        )  # fmt: skip
    figure.update_layout(hovermode="x")
    figure.update_xaxes(title="time since the prediction (s)", hoverformat=".3f", row=1, col=1)
    figure.update_xaxes(title="cushion contacts since the prediction", dtick=1, row=1, col=2)
    return figure.update_yaxes(title="error (mm)", rangemode="tozero", hoverformat=".1f", row=1, col=1)


def build_parameter_figure(parameters: Sequence[Parameter]) -> go.Figure:
    """Build a plot with one row per parameter: value, standard deviation and textbook range.

    Args:
        parameters: Fitted parameters.

    Returns:
        The figure; parameters that are determined by their priors alone are hollow and grey.
    """
    figure = make_subplots(rows=len(parameters), cols=1, vertical_spacing=0.5 / len(parameters))
    for row, p in enumerate(parameters, start=1):
        colour = "#6b7280" if p.prior_only else "#0f5c42"
        figure.add_scatter(
            x=[p.value], y=[""], error_x={"type": "data", "array": [p.sigma], "color": colour}, row=row, col=1,
            mode="markers", marker={"color": colour, "size": 10, "symbol": "circle-open" if p.prior_only else "circle"},
            showlegend=False, name=p.name,
            hovertemplate=f"{format_with_sigma(p.value, p.sigma)}<extra>{format_parameter_name(p.name)}</extra>",
        )  # fmt: skip
        ends = [p.value - p.sigma, p.value + p.sigma]
        usual = TEXTBOOK_RANGES.get(p.name)
        if usual is not None:
            figure.add_vrect(
                x0=usual[0], x1=usual[1], fillcolor="#bcd9cb", opacity=0.7, line_width=0, layer="below", row=row, col=1
            )
            ends += usual
        room = AXIS_MARGIN * (max(ends) - min(ends)) or 1.0
        figure.update_xaxes(range=[min(ends) - room, max(ends) + room], row=row, col=1)
        figure.add_annotation(
            text=format_parameter_name(p.name),
            xref="x domain",
            yref="y domain",
            x=0,
            y=1.0,
            yanchor="bottom",
            showarrow=False,
            row=row,
            col=1,
        )
    figure.update_layout(margin_t=22, hovermode="y")  # room for the first label; a tap beside a bar is enough
    figure.update_yaxes(visible=False)
    return figure
