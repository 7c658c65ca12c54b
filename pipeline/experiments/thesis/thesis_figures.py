"""The figures of the thesis from new results: series (5 and 7), errors by method (6 and 8), and error over time."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.core.errors import OptionError
from pipeline.experiments.thesis.compared_methods import CONSTRAINT_NET, PHYSICS_NAME, SPLINES, THESIS_NET, THESIS_NETS
from pipeline.experiments.thesis.scenes.withheld_series import WithheldSeries
from pipeline.experiments.thesis.thesis_sentences import SettingResult, trial_setting
from pipeline.experiments.thesis.trials import Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, SOFT, LINE = "#1b2420", "#55605a", "#d8dedb"
CURVE, PHYSICS, THESIS, NET = "#6b7a73", "#0f5c42", "#c62828", "#3b6ea5"
"""Colours of splines, the physics fit, the networks of the thesis, all other networks."""
RIVAL = "#b5762a"
"""Colour of ConstraintNet in figures with few lines."""
DPI = 150
"""Resolution, dots per inch."""
MIN_PLOTTED_ERROR = 1e-4
"""px: smaller errors are plotted as this."""


@dataclass(frozen=True, slots=True)
class ThesisFigure:
    """One figure."""

    name: str
    """Base name of its file."""
    title: str
    png: bytes


def method_colour(method: str) -> str:
    """Return the colour of a method by its kind."""
    if method == PHYSICS_NAME:
        return PHYSICS
    if method in THESIS_NETS:
        return THESIS
    return CURVE if method in ("linear", *SPLINES) else NET


@contextmanager
def open_figure(width: float, height: float, rows: int = 1, columns: int = 1) -> Iterator[tuple[Figure, np.ndarray]]:
    """Open a figure of width by height inches with a grid of axes (rows, columns) in the common style."""
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError("Plots need matplotlib: install trueroll[check]") from error
    with rc_context(
        {"font.size": 9, "axes.edgecolor": LINE, "axes.labelcolor": SOFT, "xtick.color": SOFT, "ytick.color": SOFT,
         "text.color": INK, "axes.spines.top": False, "axes.spines.right": False}
    ):  # fmt: skip
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure, figure.subplots(rows, columns, squeeze=False)


def encode_figure(figure: Figure, name: str, title: str) -> ThesisFigure:
    """Encode a figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, facecolor="white", metadata={"Software": None})
    return ThesisFigure(name, title, buffer.getvalue())


def plot_pendulum_series(series: WithheldSeries) -> ThesisFigure:
    """Plot figure 5: coordinates of the two free balls over time, and their paths."""
    with open_figure(9.0, 3.4, 1, 2) as (figure, axes):
        over, path = axes[0]
        for ball, colour in ((1, NET), (2, THESIS)):
            for axis, style in ((0, "-"), (1, "--")):
                over.plot(series.t, series.truth[:, ball, axis], style, color=colour, lw=1.2,
                          label=f"{'xy'[axis]} of ball {ball + 1}")  # fmt: skip
            path.plot(*series.truth[:, ball].T, "-", color=colour, lw=0.8, alpha=0.6)
            path.plot(*series.visible_samples[1][:, ball].T, "o", color=colour, ms=3)
        path.plot(*series.truth[0].T, "-o", color=INK, lw=1.5, ms=5)
        over.set(xlabel="time, s", ylabel="px")
        over.legend(frameon=False, ncols=4, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        _set_image_axes(path)
        case = series.case
        return encode_figure(
            figure, "figure-5-double-pendulum", f"Figure 5: the double pendulum ({case.variant} springs)"
        )


def plot_boxes_series(series: WithheldSeries, bodies: np.ndarray) -> ThesisFigure:
    """Plot figure 7: the ball and the boxes at four moments."""
    with open_figure(11.0, 2.3, 1, 4) as (figure, axes):
        moments = np.linspace(0, len(series.t) - 1, 4).astype(int)
        for panel, frame in zip(axes[0], moments, strict=True):
            for body in range(1, bodies.max() + 1):
                corners = series.truth[frame, bodies == body]
                panel.fill(*corners.T, facecolor="#e8eef5", edgecolor=NET, lw=0.6)
            panel.plot(*series.truth[: frame + 1, 0].T, "-", color=THESIS, lw=0.8)
            panel.plot(*series.truth[frame, 0], "o", color=THESIS, ms=8)
            panel.set_title(f"{series.t[frame]:.2f} s", color=SOFT, fontsize=9)
            _set_image_axes(panel)
        _share_limits(axes[0])
        return encode_figure(
            figure, "figure-7-boxes", f"Figure 7: a ball at {series.case.variant} px/s into fifty boxes"
        )


def plot_errors_by_method(
    cells: Sequence[SettingResult], trials: Sequence[Trial], name: str, title: str
) -> ThesisFigure:
    """Plot figures 6 and 8: the error of every method, one panel per setting; medians are bars, seeds are dots."""
    methods = list(dict.fromkeys(trial.method for trial in trials if any(trial.method in cell.mse for cell in cells)))
    columns = min(len(cells), 3)
    rows = -(-len(cells) // columns)
    with open_figure(1.6 + 3.1 * columns, 0.8 + rows * (0.5 + 0.2 * len(methods)), rows, columns) as (figure, axes):
        for panel in axes.ravel()[len(cells) :]:
            panel.set_visible(False)
        for panel, cell in zip(axes.ravel(), cells, strict=False):
            _plot_setting(panel, cell, methods, [trial for trial in trials if _is_in_setting(trial, cell)])
        for panel in axes[:, 1:].ravel():
            panel.set_yticklabels([])
        return encode_figure(figure, name, title)


def _plot_setting(panel: Axes, cell: SettingResult, methods: list[str], trials: list[Trial]) -> None:
    """Plot the errors of one setting."""
    for place, method in enumerate(methods):
        dots = [max(trial.mse, 1e-12) for trial in trials if trial.method == method]
        if method in cell.mse:
            panel.plot(
                [max(cell.mse[method], 1e-12)] * 2, [place - 0.35, place + 0.35], color=method_colour(method), lw=3
            )
            panel.plot(dots, [place] * len(dots), "o", color=method_colour(method), ms=3.5, alpha=0.6)
    panel.axvline(cell.mse["linear"], color=LINE, lw=1, zorder=0)
    panel.set_xscale("log")
    panel.set_yticks(range(len(methods)), methods)
    panel.invert_yaxis()
    panel.set_title(cell.setting, color=SOFT, fontsize=9)
    panel.set_xlabel("mse, px²")
    panel.grid(axis="x", color=LINE, lw=0.5)


def plot_error_over_time(trials: Sequence[Trial], cell: SettingResult, name: str, title: str) -> ThesisFigure:
    """Plot the root mean square error at each withheld midpoint of one setting, for the first seed."""
    there = [trial for trial in trials if _is_in_setting(trial, cell) and trial.method in cell.mse]
    first = min(trial.case.seed for trial in there)
    curves = _select_curves([trial for trial in there if trial.case.seed == first])
    with open_figure(9.0, 4.0) as (figure, axes):
        panel = axes[0, 0]
        for trial, (colour, style) in curves:
            panel.plot(trial.t, trial.error.clip(MIN_PLOTTED_ERROR), style, color=colour, lw=1.5, label=trial.method)
        panel.set(yscale="log", xlabel="time, s", ylabel="error at the midpoint, px")
        panel.grid(axis="y", color=LINE, lw=0.5)
        panel.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        return encode_figure(figure, name, f"{title} ({cell.setting})")


def plot_loss_curves(trials: Sequence[Trial], name: str, title: str) -> ThesisFigure:
    """Plot the least loss so far relative to the first: losses of networks are not comparable."""
    columns = min(len(trials), 4)
    rows = -(-len(trials) // columns)
    with open_figure(1.0 + 2.3 * columns, 0.4 + 1.5 * rows, rows, columns) as (figure, axes):
        for panel in axes.ravel()[len(trials) :]:
            panel.set_visible(False)
        for panel, trial in zip(axes.ravel(), trials, strict=False):
            share = trial.loss / trial.loss[0]
            panel.plot(share, color=LINE, lw=1)
            panel.plot(np.fmin.accumulate(share), color=method_colour(trial.method), lw=1.5)
            panel.set(yscale="log")
            panel.set_title(trial.method, color=SOFT, fontsize=9)
        for panel in axes[-1]:
            panel.set_xlabel("step")
        for panel in axes[:, 0]:
            panel.set_ylabel("loss, first = 1")
        return encode_figure(figure, name, title)


def _select_curves(trials: list[Trial]) -> list[tuple[Trial, tuple[str, str]]]:
    """Select a readable number of curves, the worst first.

    They are the simplest splines, the network of the thesis, ConstraintNet, the best other network and the physics fit.
    """
    looks = {"linear": (CURVE, ":"), "cubic": (CURVE, "--"), "akima": (CURVE, "-"), THESIS_NET: (THESIS, "-"),
             CONSTRAINT_NET: (RIVAL, "-"), PHYSICS_NAME: (PHYSICS, "-")}  # fmt: skip
    others = [trial for trial in trials if method_colour(trial.method) == NET and trial.method not in looks]
    if others:
        looks[min(others, key=lambda trial: trial.mse).method] = (NET, "-")
    chosen = sorted((trial for trial in trials if trial.method in looks), key=lambda trial: -trial.mse)
    return [(trial, looks[trial.method]) for trial in chosen]


def _is_in_setting(trial: Trial, cell: SettingResult) -> bool:
    """Return whether a trial belongs to a setting."""
    return trial_setting(trial) == (cell.scene, cell.variant, cell.fps, cell.noise)


def _set_image_axes(panel: Axes) -> None:
    """Point y down and set equal scales, as in an image."""
    panel.set_aspect("equal")
    panel.invert_yaxis()
    panel.tick_params(labelsize=7)


def _share_limits(panels: Sequence[Axes]) -> None:
    """Set the widest limits for all panels."""
    wide, tall = (np.array([getattr(panel, f"get_{axis}lim")() for panel in panels]) for axis in "xy")
    for panel in panels:
        panel.set_xlim(wide.min(), wide.max())
        panel.set_ylim(tall.max(), tall.min())
