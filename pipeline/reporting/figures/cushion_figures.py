"""Page beside a learned profile: what its cushions do over speed, angle and spin, with and without the network."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle, product
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.table_learning.learned_table import LearnedTable, rebound_rolling_balls
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODELS
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from pipeline.engine.atomic_write import write_text
from pipeline.io.table_profile import parse_learned_table

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
