"""The results as files: trials.csv, and one self-contained page with tables and figures."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from pipeline.engine.atomic_write import write_text
from pipeline.experiments.thesis.compared_methods import (
    CONSTRAINT_NET,
    PHYSICS_NAME,
    PRETRAINED_NET,
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
from pipeline.experiments.thesis.scenes.boxes_scene import body_indices
from pipeline.experiments.thesis.scenes.withheld_series import WithheldSeries
from pipeline.experiments.thesis.thesis_sentences import (
    SettingResult,
    compute_gains,
    describe_scene_results,
    find_best_method,
    format_times,
    summarize_settings,
    trial_setting,
)
from pipeline.experiments.thesis.trials import Trial
from pipeline.reporting.pages.page_template import embed_figure, pack_plotly_source, render_template

TITLES = {
    "double-pendulum": "Scene I: the double pendulum",
    "real": "Scene I, filmed: a real double pendulum",
    "boxes": "Scene II: a ball into fifty boxes",
    "pool": "Scene III: pool, from a real clip",
}
# Name of a variant of a scene.
UNITS = {"double-pendulum": "{} springs", "real": "From {} on", "boxes": "A ball of {} px/s", "pool": "{}"}
# Compared methods, the best of which counts, with their rivals.
COMPARISONS = (
    (f"network of the thesis ({THESIS_NET})", (THESIS_NET,), "linear"),
    (f"network of the thesis ({THESIS_NET})", (THESIS_NET,), CONSTRAINT_NET),
    ("best spline", SPLINES, "linear"),
    (CONSTRAINT_NET, (CONSTRAINT_NET,), "linear"),
    (PRETRAINED_NET, (PRETRAINED_NET,), "linear"),
    ("fit of the physics", (PHYSICS_NAME,), "cubic"),
)
COMPARISON_HEADS = ["median", "lowest", "highest", "lower in"]
# Largest number of panels of a figure.
MAX_PANELS = 9


@dataclass(frozen=True, slots=True)
class TableCell:
    """One cell of a table."""

    text: str
    look: str
    """Style: best, worse (than linear), or empty."""


@dataclass(frozen=True, slots=True)
class MethodRow:
    """The cells of one method."""

    method: str
    cells: list[TableCell]


@dataclass(frozen=True, slots=True)
class ResultTable:
    """Error of every method relative to linear interpolation; one column per frame rate and noise."""

    caption: str
    heads: list[str]
    rows: list[MethodRow]


def write_results(plan: ExperimentPlan, trials: Sequence[Trial], planned: int, folder: Path) -> None:
    """Write the table of trials and the page; each file appears whole or not at all.

    Args:
        plan: The requested experiments.
        trials: The finished trials.
        planned: Number of planned trials.
        folder: Output folder.
    """
    results = summarize_settings(trials)
    figures = {scene: _plot_scene(scene, results, trials, plan) for scene in SCENES}
    write_text(folder / "trials.csv", format_csv(trials))
    write_text(folder / "reproduce.html", _render_page(plan, trials, planned, results, figures))


def format_csv(trials: Sequence[Trial]) -> str:
    """Format one row per trial, with the columns of the contract first."""
    text = io.StringIO()
    rows = [trial.row for trial in trials]
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["scene"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def build_tables(scene: str, results: list[SettingResult]) -> list[ResultTable]:
    """Build the comparison of the methods over all settings of a scene, and a table for each variant."""
    here = [cell for cell in results if cell.scene == scene]
    variants = dict.fromkeys(cell.variant for cell in here)
    tables = [_build_table(variant, [cell for cell in here if cell.variant == variant]) for variant in variants]
    return [_compare_methods(here), *tables]


def _compare_methods(here: list[SettingResult]) -> ResultTable:
    """Compare methods with their rivals over all settings of a scene."""
    rows = []
    for name, methods, rival in COMPARISONS:
        gains = [gain for _, gain in compute_gains(here, methods, rival)]
        if gains:
            better = sum(gain > 1 for gain in gains)
            texts = [*map(format_times, (median(gains), min(gains), max(gains))), f"{better} of {len(gains)}"]
            rows.append(MethodRow(f"{name}, than {rival}", [TableCell(text, "") for text in texts]))
    return ResultTable("How many times lower the error is, over all settings", COMPARISON_HEADS, rows)


def _build_table(variant: str, here: list[SettingResult]) -> ResultTable:
    methods = dict.fromkeys(name for cell in here for name in (*cell.mse, *cell.untrained))
    heads = [f"{cell.fps:.3g} Hz, {cell.noise:g} px" for cell in here]
    first = MethodRow("linear: mse, px²", [TableCell(f"{cell.mse['linear']:.3g}", "worse") for cell in here])
    rest = [MethodRow(name, [_format_cell(cell, name) for cell in here]) for name in methods if name != "linear"]
    name = UNITS[here[0].scene].format(variant)
    return ResultTable(f"{name[0].upper()}{name[1:]}: how many times lower than linear", heads, [first, *rest])


def _format_cell(cell: SettingResult, name: str) -> TableCell:
    if name in cell.untrained:
        return TableCell(f"not trained to the end ({cell.untrained[name]:.0f} s)", "worse")
    if name not in cell.mse:
        return TableCell("-", "worse")
    gain = cell.mse["linear"] / max(cell.mse[name], 1e-300)
    leader = find_best_method(cell, cell.mse)
    look = "best" if leader is not None and leader[0] == name else "worse" if gain < 1 else ""
    return TableCell(format_times(gain) if gain >= 1e-3 else "lost", look)


def build_learning_table(scene: str, trials: Sequence[Trial]) -> ResultTable | None:
    """Build the table of training costs in the first setting of a scene, where all methods run: medians over seeds."""
    here = [trial for trial in trials if trial.case.scene == scene]
    setting = trial_setting(here[0]) if here else None
    by_method: dict[str, list[Trial]] = {}
    for trial in here:
        if trial_setting(trial) == setting and trial.parameters:
            by_method.setdefault(trial.method, []).append(trial)
    if not by_method:
        return None
    rows = [
        MethodRow(_name_with_state(method, some), [TableCell(text, "") for text in _format_learning_cost(some)])
        for method, some in by_method.items()
    ]
    return ResultTable("Training cost of the methods, in the first setting", ["parameters", "steps", "CPU s"], rows)


def _name_with_state(method: str, trials: list[Trial]) -> str:
    return method if all(trial.is_trained for trial in trials) else f"{method}, not trained to the end"


def _format_learning_cost(trials: list[Trial]) -> tuple[str, str, str]:
    numbers, steps = (int(median(values)) for values in (
        [trial.parameters for trial in trials], [len(trial.loss) for trial in trials]
    ))  # fmt: skip
    seconds = median(trial.seconds for trial in trials)
    return f"{numbers:,}", f"{steps:,}" if steps else "-", f"{seconds:.1f}"


def _plot_scene(
    scene: str, results: list[SettingResult], trials: Sequence[Trial], plan: ExperimentPlan
) -> list[ThesisFigure]:
    here = [trial for trial in trials if trial.case.scene == scene]
    if not here:
        return []
    settings = [cell for cell in results if cell.scene == scene][:MAX_PANELS]
    number = {"double-pendulum": "6", "boxes": "8"}.get(scene)
    name = f"figure-{number}-{scene}-errors" if number else f"{scene}-errors"
    kind = f"Figure {number}: error" if number else "Error"
    title = f"{kind} of every method; bars are medians over seeds, dots are seeds"
    middle = settings[len(settings) // 2]
    return [
        *_plot_series(here[0], plan),
        plot_errors_by_method(settings, here, name, title),
        plot_error_over_time(here, middle, f"{scene}-error-over-time", "Error over time"),
    ]


def _plot_series(trial: Trial, plan: ExperimentPlan) -> list[ThesisFigure]:
    if trial.case.scene == "double-pendulum":
        return [plot_pendulum_series(build_case_series(trial.case, plan))]
    if trial.case.scene == "boxes":
        return [plot_boxes_series(build_case_series(trial.case, plan), np.asarray(body_indices()))]
    return []


def _render_page(
    plan: ExperimentPlan,
    trials: Sequence[Trial],
    planned: int,
    results: list[SettingResult],
    figures: dict[str, list[ThesisFigure]],
) -> str:
    scenes = [
        {
            "title": TITLES[scene],
            "said": describe_scene_results(scene, results, plan.budget(scene).effort),
            "given": describe_extra_inputs(scene, {trial.method for trial in trials if trial.case.scene == scene}),
            "tables": [*build_tables(scene, results), *filter(None, [build_learning_table(scene, trials)])],
            "figures": [(one.title, embed_figure(one.figure, one.name, one.height)) for one in figures[scene]],
        }
        for scene in SCENES
        if any(cell.scene == scene for cell in results)
    ]
    return render_template(
        "reproduce.html",
        seeds=len({trial.case.seed for trial in trials}), trained=describe_training(plan),
        done=len(trials), planned=planned, left_out=explain_omissions(plan), scenes=scenes, notes=_count_notes(trials),
        plotly=pack_plotly_source(),
    )  # fmt: skip


def _count_notes(trials: Sequence[Trial]) -> list[str]:
    """Count the warnings of methods about their own motions."""
    counts = Counter((trial.case.scene, trial.case.variant, trial.method, trial.note) for trial in trials if trial.note)
    return [
        f"{scene}, {variant}, {method}: {note}{f' ({count} times)' if count > 1 else ''}"
        for (scene, variant, method, note), count in counts.items()
    ]


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


@dataclass(frozen=True, slots=True)
class ThesisFigure:
    """One figure."""

    name: str
    """Its name on the page."""
    title: str
    figure: go.Figure
    height: int
    """Height, px; the width follows the page."""


def method_colour(method: str) -> str:
    """Return the colour of a method by its kind."""
    if method == PHYSICS_NAME:
        return PHYSICS
    if method in THESIS_NETS:
        return THESIS
    return CURVE if method in ("linear", *SPLINES) else NET


def _finish_figure(figure: go.Figure, height: int, name: str, title: str) -> ThesisFigure:
    """Place the legend below the axes; axes are as tall as the figure without its margins."""
    legend = {"y": -58 / (height - sum(MARGINS.values()))}
    return ThesisFigure(name, title, figure.update_layout(margin=MARGINS, legend=legend), height)


def _space_rows(rows: int, height: int) -> float:
    """Return the space between rows of panels, as a share of the height of all axes."""
    return ROW_SPACE / (height - sum(MARGINS.values())) if rows > 1 else 0.0


def plot_pendulum_series(series: WithheldSeries) -> ThesisFigure:
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


def plot_boxes_series(series: WithheldSeries, bodies: np.ndarray) -> ThesisFigure:
    """Plot figure 7: the ball and the boxes at four moments."""
    moments = np.linspace(0, len(series.t) - 1, 4).astype(int)
    figure = make_subplots(
        1, len(moments), shared_yaxes=True, horizontal_spacing=0.02,
        subplot_titles=[f"{series.t[frame]:.2f} s" for frame in moments],
    )  # fmt: skip
    for column, frame in enumerate(moments, 1):
        here, shown = {"row": 1, "col": column}, column == 1
        outlines = np.concatenate(list(_outline_boxes(series.truth[frame], bodies)))
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


def _outline_boxes(points: np.ndarray, bodies: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the closed outline (6, 2) of every box, with NaN at its end; body 0 is the ball."""
    for body in range(1, bodies.max() + 1):
        corners = points[bodies == body]
        yield np.concatenate([corners, corners[:1], np.full((1, 2), np.nan)])


def plot_errors_by_method(
    cells: Sequence[SettingResult], trials: Sequence[Trial], name: str, title: str
) -> ThesisFigure:
    """Plot figures 6 and 8: the error of every method, one panel per setting; medians are bars, seeds are dots."""
    methods = list(dict.fromkeys(trial.method for trial in trials if any(trial.method in cell.mse for cell in cells)))
    columns = min(len(cells), 3)
    rows = -(-len(cells) // columns)
    height = rows * (ROW_SPACE + ROW_HEIGHT * len(methods)) + sum(MARGINS.values())
    figure = make_subplots(
        rows, columns, shared_yaxes=True, horizontal_spacing=0.03, vertical_spacing=_space_rows(rows, height),
        subplot_titles=[cell.setting for cell in cells],
    )  # fmt: skip
    for k, cell in enumerate(cells):
        here = {"row": k // columns + 1, "col": k % columns + 1}
        _plot_setting(figure, cell, methods, [trial for trial in trials if _is_in_setting(trial, cell)], here)
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
    return _finish_figure(figure, height, name, title)


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


def plot_error_over_time(trials: Sequence[Trial], cell: SettingResult, name: str, title: str) -> ThesisFigure:
    """Plot the root mean square error at each withheld midpoint of one setting, for the first seed."""
    there = [trial for trial in trials if _is_in_setting(trial, cell) and trial.method in cell.mse]
    first = min(trial.case.seed for trial in there)
    figure = go.Figure()
    for trial, (colour, dash) in _select_curves([trial for trial in there if trial.case.seed == first]):
        figure.add_scatter(
            x=trial.t, y=trial.error.clip(MIN_PLOTTED_ERROR), mode="lines", name=trial.method,
            line={"color": colour, "dash": dash, "width": 2},
        )  # fmt: skip
    figure.update_xaxes(title="time (s)")
    figure.update_yaxes(title="error at the midpoint (px)", type="log", dtick=1, exponentformat="power")
    return _finish_figure(figure, 430, name, f"{title} ({cell.setting})")


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


def _is_in_setting(trial: Trial, cell: SettingResult) -> bool:
    """Return whether a trial belongs to a setting."""
    return trial_setting(trial) == (cell.scene, cell.variant, cell.fps, cell.noise)
