"""The figures of a run's page: the table from above, speeds, energies, and what was fitted beside textbooks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from models.core.fit_result import Fit, Parameter
from models.core.scene import Scene
from models.core.typing import FloatArray
from pipeline.reporting.figures.motion_samples import ever_moves, kinetic_energy, moments
from pipeline.reporting.text.sentences import event_sentence, event_time, parameter_words, textbook_range
from video.drawing.palette import INK, Colour, mix

PLOT_HZ = 60.0
HOVER = "%{customdata[0]:.3f} s, %{customdata[1]:.2f} m/s"
TOUCHES = ("strike", "ball", "cushion", "pocket")
ROW_PX = 92
"""Height of a parameter."""
ROOM = 0.15
"""Of an axis, about what is drawn on it."""


def page_colour(colour: Colour) -> str:
    """A ball's colour on a white page: darkened where it would not be seen."""
    red, green, blue = mix(colour, INK, 0.35 if min(colour) > 150 else 0.0)
    return f"rgb({red},{green},{blue})"


def plan_figure(scene: Scene, fit: Fit, colours: Sequence[str]) -> go.Figure:
    """The table from above: fitted paths, balls where they come to; y runs down, as in the picture."""
    table = scene.table
    figure = go.Figure()
    figure.add_shape(type="rect", x0=0, y0=0, x1=table.length, y1=table.width, line={"color": "#4b6b5d", "width": 3})
    for x, y in table.pocket_centres:
        r = 1.6 * table.ball_radius
        figure.add_shape(type="circle", x0=x - r, y0=y - r, x1=x + r, y1=y + r, fillcolor="#30343a", line_width=0)
    t = moments(fit.trajectory, PLOT_HZ)
    state = fit.trajectory.at(t)
    hover = np.stack(np.broadcast_arrays(t[:, None], np.linalg.norm(state.v, axis=-1)), axis=-1)
    moves = ever_moves(state.xy, table.ball_radius)
    for k, ball in enumerate(fit.trajectory.ids):
        rows = np.flatnonzero(np.isfinite(state.xy[:, k, 0]))
        if not len(rows):
            continue
        for shown, mode in ((rows if moves[k] else rows[:0], "lines"), (rows[-1:], "markers")):
            figure.add_scatter(
                x=state.xy[shown, k, 0], y=state.xy[shown, k, 1], mode=mode, name=ball, legendgroup=ball,
                marker_size=10, showlegend=mode == "markers", line_color=colours[k], marker_color=colours[k],
                customdata=hover[shown, k], hovertemplate=f"{HOVER}<extra>{ball}</extra>",
            )  # fmt: skip
    _add_contacts(figure, fit)
    rim = 0.04 * table.length
    figure.update_yaxes(
        range=[table.width + rim, -rim], scaleanchor="x", constrain="domain", constraintoward="top", title="y (m)"
    )
    return figure.update_xaxes(range=[-rim, table.length + rim], constrain="domain", title="x (m)")


def _add_contacts(figure: go.Figure, fit: Fit) -> None:
    events = fit.events
    marked = [k for k in range(len(events)) if events.kind[k] in TOUCHES]
    figure.add_scatter(
        x=events.xy[marked, 0], y=events.xy[marked, 1], mode="markers", name="contacts", customdata=marked,
        marker={"symbol": "x", "size": 9, "color": "#c2410c"},
        text=[f"{event_time(events, k)}<br>{event_sentence(events, k)}" for k in marked],
        hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip


def speed_figure(scene: Scene, fit: Fit, colours: Sequence[str]) -> go.Figure:
    """Speed of every ball that moves, over the time of the source clip."""
    t = moments(fit.trajectory, PLOT_HZ)
    state = fit.trajectory.at(t)
    figure = _over_time(scene, fit, colours, t, np.linalg.norm(state.v, axis=-1), state.xy)
    return figure.update_yaxes(title="speed (m/s)", rangemode="tozero")


def energy_figure(scene: Scene, fit: Fit, colours: Sequence[str]) -> go.Figure:
    """Kinetic energy of every ball that moves and of all together, over the time of the source clip."""
    t = moments(fit.trajectory, PLOT_HZ)
    state = fit.trajectory.at(t)
    energy = 1000 * kinetic_energy(state, scene.table)
    figure = _over_time(scene, fit, colours, t, energy, state.xy)
    moves = ever_moves(state.xy, scene.table.ball_radius)
    if moves.sum() > 1:
        whole = np.nansum(energy[:, moves], axis=1)
        figure.add_scatter(x=t, y=whole, mode="lines", name="all balls", line={"color": "#1f4e9c", "dash": "dash"})
    return figure.update_yaxes(title="energy (mJ)", rangemode="tozero")


def _over_time(
    scene: Scene, fit: Fit, colours: Sequence[str], t: FloatArray, values: FloatArray, xy: FloatArray
) -> go.Figure:
    figure = go.Figure()
    moves = ever_moves(xy, scene.table.ball_radius)
    for k, ball in enumerate(fit.trajectory.ids):
        if moves[k]:
            figure.add_scatter(x=t, y=values[:, k], mode="lines", name=ball, line_color=colours[k])
    line = {"width": 1, "dash": "dot", "color": "#9ca3af"}
    marks = [
        {"type": "line", "xref": "x", "yref": "y domain", "x0": when, "x1": when, "y0": 0, "y1": 1, "line": line}
        for when, kind in zip(fit.events.t.tolist(), fit.events.kind, strict=True)
        if kind in ("strike", "ball", "cushion")
    ]
    figure.update_layout(shapes=marks)  # all at once: each that is added alone has all others checked again
    return figure.update_xaxes(title="time of the clip (s)")


def parameter_figure(parameters: Sequence[Parameter]) -> go.Figure:
    """A row per parameter: its value with two standard deviations, over the band that textbooks give."""
    figure = make_subplots(rows=len(parameters), cols=1, vertical_spacing=0.5 / len(parameters))
    for row, p in enumerate(parameters, start=1):
        told = "#6b7280" if p.prior_only else "#0f5c42"
        figure.add_scatter(
            x=[p.value], y=[""], error_x={"type": "data", "array": [2 * p.sigma], "color": told}, row=row, col=1,
            mode="markers", marker={"color": told, "size": 10, "symbol": "circle-open" if p.prior_only else "circle"},
            showlegend=False, name=p.name,
            hovertemplate=f"{p.value:.4g} ± {p.sigma:.2g}<extra>{parameter_words(p.name)}</extra>",
        )  # fmt: skip
        ends = [p.value - 2 * p.sigma, p.value + 2 * p.sigma]
        usual = textbook_range(p.name)
        if usual is not None:
            figure.add_vrect(
                x0=usual[0], x1=usual[1], fillcolor="#bcd9cb", opacity=0.7, line_width=0, layer="below", row=row, col=1
            )
            ends += usual
        room = ROOM * (max(ends) - min(ends)) or 1.0
        figure.update_xaxes(range=[min(ends) - room, max(ends) + room], row=row, col=1)
        figure.add_annotation(
            text=parameter_words(p.name),
            xref="x domain",
            yref="y domain",
            x=0,
            y=1.0,
            yanchor="bottom",
            showarrow=False,
            row=row,
            col=1,
        )
    figure.update_yaxes(visible=False)
    return figure
