"""The results as files: trials.csv, and one self-contained page with tables and figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from pipeline.engine.atomic_write import write_text
from pipeline.experiments.thesis.compared_methods import (
    CONSTRAINT_NET,
    PHYSICS_NAME,
    SPLINES,
    THESIS_NET,
    THESIS_NETS,
    describe_extra_inputs,
)
from pipeline.experiments.thesis.experiment_plan import (
    SCENES,
    ExperimentPlan,
    build_case_series,
    describe_training,
    explain_omissions,
)
from pipeline.experiments.thesis.thesis_results import (
    SettingResult,
    build_learning_table,
    build_tables,
    describe_scene_results,
    format_csv,
    summarize_settings,
)
from pipeline.experiments.thesis.thesis_scenes import WithheldSeries, body_indices
from pipeline.experiments.thesis.trials import Trial
from pipeline.reporting.pages.page_template import embed_figure, pack_plotly_source, render_template

TITLES = {
    "double-pendulum": "Scene I: the double pendulum",
    "real": "Scene I, filmed: a real double pendulum",
    "boxes": "Scene II: a ball into fifty boxes",
    "pool": "Scene III: pool, from a real clip",
}
# Title of a figure, and the figure as HTML.
PageFigure = tuple[str, str]


def write_results(plan: ExperimentPlan, trials: Sequence[Trial], planned: int, folder: Path) -> None:
    """Write the table of trials and the page; each file appears whole or not at all.

    Args:
        plan: The requested experiments.
        trials: The finished trials.
        planned: Number of planned trials.
        folder: Output folder.
    """
    results = summarize_settings(trials)
    # warnings of methods about their own motions
    notes = Counter((trial.case.scene, trial.case.variant, trial.method, trial.note) for trial in trials if trial.note)
    html = render_template(
        "reproduce.html",
        seeds=len({trial.case.seed for trial in trials}), trained=describe_training(plan), done=len(trials),
        planned=planned, left_out=explain_omissions(plan), plotly=pack_plotly_source(),
        scenes=[_describe_scene(scene, plan, trials, results) for scene in SCENES
                if any(cell.case.scene == scene for cell in results)],
        notes=[f"{scene}, {variant}, {method}: {note}{f' ({count} times)' if count > 1 else ''}"
               for (scene, variant, method, note), count in notes.items()],
    )  # fmt: skip
    write_text(folder / "trials.csv", format_csv(trials))
    write_text(folder / "reproduce.html", html)


def _describe_scene(
    scene: str, plan: ExperimentPlan, trials: Sequence[Trial], results: list[SettingResult]
) -> dict[str, object]:
    """Describe a scene for the page: sentences, tables and figures."""
    here = [trial for trial in trials if trial.case.scene == scene]
    settings = [cell for cell in results if cell.case.scene == scene][:MAX_PANELS]
    middle = settings[len(settings) // 2]
    series = (
        _plot_pendulum_series(build_case_series(here[0].case, plan)) if scene == "double-pendulum"
        else _plot_boxes_series(build_case_series(here[0].case, plan)) if scene == "boxes" else None
    )  # fmt: skip
    return {
        "title": TITLES[scene],
        "said": describe_scene_results(scene, results, plan.budget(scene).effort),
        "given": describe_extra_inputs(scene, {trial.method for trial in here}),
        "tables": [*build_tables(scene, results), *filter(None, [build_learning_table(scene, trials)])],
        "figures": [
            *filter(None, [series]), _plot_errors_by_method(settings, here), _plot_error_over_time(here, middle)
        ],
    }  # fmt: skip


# Largest number of panels of a figure.
MAX_PANELS = 9
INK, LINE = "#1b2420", "#b9c2be"
# Colours of splines, the physics fit, the networks of the thesis, all other networks.
CURVE, PHYSICS, THESIS, NET = "#6b7a73", "#0f5c42", "#c62828", "#3b6ea5"
# Colour of ConstraintNet in figures with few lines.
RIVAL = "#b5762a"
METHOD_KINDS = {CURVE: "curves", THESIS: "networks of the thesis", NET: "other networks", PHYSICS: "fit of the physics"}
# px: smaller errors are plotted as this.
MIN_PLOTTED_ERROR = 1e-4
# px²: smaller mean squared errors are plotted as this.
MIN_PLOTTED_MSE = MIN_PLOTTED_ERROR**2
# Height of the row of one method, px.
ROW_HEIGHT = 21
# Space between two rows of panels, px.
ROW_SPACE = 70
# Space for the titles of panels and for the legend, px.
MARGINS = {"t": 34, "b": 90}


def method_colour(method: str) -> str:
    """Return the colour of a method by its kind."""
    if method == PHYSICS_NAME:
        return PHYSICS
    if method in THESIS_NETS:
        return THESIS
    return CURVE if method in ("linear", *SPLINES) else NET


def _finish_figure(figure: go.Figure, height: int, name: str, title: str) -> PageFigure:
    """Place the legend below the axes; axes are as tall as the figure without its margins."""
    legend = {"y": -58 / (height - sum(MARGINS.values()))}
    return title, embed_figure(figure.update_layout(margin=MARGINS, legend=legend), name, height)


def _plot_pendulum_series(series: WithheldSeries) -> PageFigure:
    """Plot figure 5: coordinates of the two free balls over time, and their paths."""
    figure = make_subplots(1, 2, column_widths=[0.62, 0.38], horizontal_spacing=0.1, subplot_titles=["", "paths"])
    for ball, colour in ((1, NET), (2, THESIS)):
        for axis, dash in ((0, "solid"), (1, "dash")):
            figure.add_scatter(
                x=series.t, y=series.truth[:, ball, axis], mode="lines", name=f"{'xy'[axis]} of ball {ball + 1}",
                line={"color": colour, "dash": dash, "width": 1.5}, row=1, col=1,
            )  # fmt: skip
        thin, dot = {"color": colour, "width": 1}, {"color": colour, "size": 4}
        for path, mode in ((series.truth[:, ball], "lines"), (series.visible_samples[1][:, ball], "markers")):
            figure.add_scatter(
                x=path[:, 0], y=path[:, 1], mode=mode, line=thin, marker=dot, showlegend=False, row=1, col=2
            )
    figure.add_scatter(
        x=series.truth[0, :, 0], y=series.truth[0, :, 1], mode="lines+markers", name="pendulum at the start",
        line={"color": INK, "width": 2}, marker={"size": 8}, row=1, col=2,
    )  # fmt: skip
    figure.add_scatter(
        x=[None], y=[None], mode="markers", name="visible samples", marker={"color": INK, "size": 4}, row=1, col=2
    )
    figure.update_xaxes(title="time (s)", row=1, col=1).update_yaxes(title="coordinate (px)", row=1, col=1)
    figure.update_xaxes(title="x (px)", row=1, col=2)
    figure.update_yaxes(title="y (px)", autorange="reversed", scaleanchor="x2", row=1, col=2)
    title = f"Figure 5: the double pendulum ({series.case.variant} springs)"
    return _finish_figure(figure, 430, "figure-5-double-pendulum", title)


def _plot_boxes_series(series: WithheldSeries) -> PageFigure:
    """Plot figure 7: the ball and the boxes at four moments."""
    moments = np.linspace(0, len(series.t) - 1, 4).astype(int)
    figure = make_subplots(
        1, len(moments), shared_yaxes=True, horizontal_spacing=0.02,
        subplot_titles=[f"{series.t[frame]:.2f} s" for frame in moments],
    )  # fmt: skip
    for column, frame in enumerate(moments, 1):
        here, shown = {"row": 1, "col": column}, column == 1
        outlines = np.concatenate(list(_outline_boxes(series.truth[frame])))
        figure.add_scatter(
            x=outlines[:, 0], y=outlines[:, 1], mode="lines", fill="toself", fillcolor="#e8eef5", name="boxes",
            line={"color": NET, "width": 1}, showlegend=shown, **here,
        )  # fmt: skip
        path = series.truth[: frame + 1, 0]
        figure.add_scatter(
            x=path[:, 0], y=path[:, 1], mode="lines", line={"color": THESIS, "width": 1.5}, name="path of the ball",
            showlegend=shown, **here,
        )  # fmt: skip
        figure.add_scatter(
            x=path[-1:, 0], y=path[-1:, 1], mode="markers", marker={"color": THESIS, "size": 11}, name="ball",
            showlegend=shown, **here,
        )  # fmt: skip
    low, high = series.truth[moments].min((0, 1)) - 20, series.truth[moments].max((0, 1)) + 20
    figure.update_xaxes(title="x (px)", range=[low[0], high[0]], constrain="domain")
    figure.update_yaxes(range=[high[1], low[1]], scaleanchor="x", constrain="domain")
    figure.update_yaxes(title="y (px)", row=1, col=1)
    title = f"Figure 7: a ball at {series.case.variant} px/s into fifty boxes"
    return _finish_figure(figure, 270, "figure-7-boxes", title)


def _outline_boxes(points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the closed outline (6, 2) of every box, with NaN at its end; body 0 is the ball."""
    bodies = body_indices()
    for body in range(1, bodies.max() + 1):
        corners = points[bodies == body]
        yield np.concatenate([corners, corners[:1], np.full((1, 2), np.nan)])


def _plot_errors_by_method(cells: Sequence[SettingResult], trials: Sequence[Trial]) -> PageFigure:
    """Plot figures 6 and 8: the error of every method, one panel per setting; medians are bars, seeds are dots."""
    scene = cells[0].case.scene
    number = {"double-pendulum": "6", "boxes": "8"}.get(scene)
    name = f"figure-{number}-{scene}-errors" if number else f"{scene}-errors"
    kind = f"Figure {number}: error" if number else "Error"
    methods = list(dict.fromkeys(trial.method for trial in trials if any(trial.method in cell.mse for cell in cells)))
    columns = min(len(cells), 3)
    rows = -(-len(cells) // columns)
    inner = rows * (ROW_SPACE + ROW_HEIGHT * len(methods))
    space = ROW_SPACE / inner if rows > 1 else 0.0
    figure = make_subplots(
        rows, columns, shared_yaxes=True, horizontal_spacing=0.03, vertical_spacing=space,
        subplot_titles=[str(cell.case) for cell in cells],
    )  # fmt: skip
    for k, cell in enumerate(cells):
        here = {"row": k // columns + 1, "col": k % columns + 1}
        _plot_setting(
            figure, cell, methods, [trial for trial in trials if trial.case.setting == cell.case.setting], here
        )
        is_lowest = k + columns >= len(cells)
        figure.update_xaxes(
            type="log", dtick=2, exponentformat="power", title="mse (px²)" if is_lowest else None, **here
        )
        figure.update_yaxes(categoryorder="array", categoryarray=methods, range=[len(methods) - 0.4, -0.6], **here)
    for colour, kind in METHOD_KINDS.items():
        if any(method_colour(method) == colour for method in methods):
            figure.add_scatter(
                x=[None], y=[None], mode="markers", name=kind, marker={"color": colour, "size": 9, "symbol": "square"}
            )
    title = f"{kind} of every method; bars are medians over seeds, dots are seeds"
    return _finish_figure(figure, inner + sum(MARGINS.values()), name, title)


def _plot_setting(
    figure: go.Figure, cell: SettingResult, methods: list[str], trials: list[Trial], here: dict[str, int]
) -> None:
    """Plot the errors of one setting."""
    linear = max(cell.mse["linear"], MIN_PLOTTED_MSE)
    figure.add_scatter(
        x=[linear, linear], y=[methods[0], methods[-1]], mode="lines", line={"color": LINE, "width": 2},
        name="linear interpolation", showlegend=here == {"row": 1, "col": 1}, **here,
    )  # fmt: skip
    shown = [trial for trial in trials if trial.method in cell.mse]
    dots = {"color": [method_colour(trial.method) for trial in shown], "size": 6, "opacity": 0.6}
    figure.add_scatter(
        x=[max(trial.mse, MIN_PLOTTED_MSE) for trial in shown], y=[trial.method for trial in shown], mode="markers",
        marker=dots, showlegend=False, name="one seed", **here,
    )  # fmt: skip
    colours = [method_colour(method) for method in cell.mse]
    bars = {"symbol": "line-ns", "size": 15, "line": {"width": 3, "color": colours}}
    figure.add_scatter(
        x=[max(mse, MIN_PLOTTED_MSE) for mse in cell.mse.values()], y=list(cell.mse), mode="markers", marker=bars,
        showlegend=False, name="median", **here,
    )  # fmt: skip


def _plot_error_over_time(trials: Sequence[Trial], cell: SettingResult) -> PageFigure:
    """Plot the root mean square error at each withheld midpoint of one setting, for the first seed."""
    there = [trial for trial in trials if trial.case.setting == cell.case.setting and trial.method in cell.mse]
    first = min(trial.case.seed for trial in there)
    figure = go.Figure()
    for trial, (colour, dash) in _select_curves([trial for trial in there if trial.case.seed == first]):
        figure.add_scatter(
            x=trial.t, y=trial.error.clip(MIN_PLOTTED_ERROR), mode="lines", name=trial.method,
            line={"color": colour, "dash": dash, "width": 2},
        )  # fmt: skip
    figure.update_xaxes(title="time (s)")
    figure.update_yaxes(title="error at the midpoint (px)", type="log", dtick=1, exponentformat="power")
    return _finish_figure(figure, 430, f"{cell.case.scene}-error-over-time", f"Error over time ({cell.case})")


def _select_curves(trials: list[Trial]) -> list[tuple[Trial, tuple[str, str]]]:
    """Select a readable number of curves, the worst first.

    They are the simplest splines, the network of the thesis, ConstraintNet, the best other network and the physics fit.
    """
    looks = {"linear": (CURVE, "dot"), "cubic": (CURVE, "dash"), "akima": (CURVE, "solid"),
             THESIS_NET: (THESIS, "solid"), CONSTRAINT_NET: (RIVAL, "solid"),
             PHYSICS_NAME: (PHYSICS, "solid")}  # fmt: skip
    others = [trial for trial in trials if method_colour(trial.method) == NET and trial.method not in looks]
    if others:
        looks[min(others, key=lambda trial: trial.mse).method] = (NET, "solid")
    chosen = sorted((trial for trial in trials if trial.method in looks), key=lambda trial: -trial.mse)
    return [(trial, looks[trial.method]) for trial in chosen]
