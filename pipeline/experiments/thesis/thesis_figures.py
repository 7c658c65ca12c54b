"""The figures of the thesis, drawn again: series (5 and 7), errors by method (6 and 8), and error over time."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.core.errors import OptionError
from pipeline.experiments.thesis.compared_methods import CONSTRAINT_NET, PHYSICS_NAME, SPLINES, THESIS_NET, THESIS_NETS
from pipeline.experiments.thesis.scenes.withheld_series import Series
from pipeline.experiments.thesis.thesis_sentences import Cell, setting_of
from pipeline.experiments.thesis.trials import Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, SOFT, LINE = "#1b2420", "#55605a", "#d8dedb"
CURVE, PHYSICS, THESIS, NET = "#6b7a73", "#0f5c42", "#c62828", "#3b6ea5"
"""Splines, the fit of the physics, the thesis' networks, all other networks."""
RIVAL = "#b5762a"
"""ConstraintNet, where lines are few."""
DPI = 150
LEAST_DRAWN = 1e-4
"""px: below it errors are as good as none."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """One figure."""

    name: str
    """Of its file, without suffix."""
    title: str
    png: bytes


def colour_of(method: str) -> str:
    """What kind of method it is."""
    if method == PHYSICS_NAME:
        return PHYSICS
    if method in THESIS_NETS:
        return THESIS
    return CURVE if method in ("linear", *SPLINES) else NET


@contextmanager
def drawing(width: float, height: float, rows: int = 1, columns: int = 1) -> Iterator[tuple[Figure, np.ndarray]]:
    """A figure of width by height inches with a grid of axes (rows, columns) in the house's look."""
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


def finished(figure: Figure, name: str, title: str) -> Drawn:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, facecolor="white", metadata={"Software": None})
    return Drawn(name, title, buffer.getvalue())


def pendulum_series(series: Series) -> Drawn:
    """Figure 5: where the two free balls are over time, and the paths they draw."""
    with drawing(9.0, 3.4, 1, 2) as (figure, axes):
        over, path = axes[0]
        for ball, colour in ((1, NET), (2, THESIS)):
            for axis, style in ((0, "-"), (1, "--")):
                over.plot(series.t, series.truth[:, ball, axis], style, color=colour, lw=1.2,
                          label=f"{'xy'[axis]} of ball {ball + 1}")  # fmt: skip
            path.plot(*series.truth[:, ball].T, "-", color=colour, lw=0.8, alpha=0.6)
            path.plot(*series.shown[1][:, ball].T, "o", color=colour, ms=3)
        path.plot(*series.truth[0].T, "-o", color=INK, lw=1.5, ms=5)
        over.set(xlabel="time, s", ylabel="px")
        over.legend(frameon=False, ncols=4, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        _upright(path)
        case = series.case
        return finished(figure, "figure-5-double-pendulum", f"Figure 5: the double pendulum ({case.variant} springs)")


def boxes_series(series: Series, bodies: np.ndarray) -> Drawn:
    """Figure 7: the ball and the boxes at four moments."""
    with drawing(11.0, 2.3, 1, 4) as (figure, axes):
        moments = np.linspace(0, len(series.t) - 1, 4).astype(int)
        for panel, frame in zip(axes[0], moments, strict=True):
            for body in range(1, bodies.max() + 1):
                corners = series.truth[frame, bodies == body]
                panel.fill(*corners.T, facecolor="#e8eef5", edgecolor=NET, lw=0.6)
            panel.plot(*series.truth[: frame + 1, 0].T, "-", color=THESIS, lw=0.8)
            panel.plot(*series.truth[frame, 0], "o", color=THESIS, ms=8)
            panel.set_title(f"{series.t[frame]:.2f} s", color=SOFT, fontsize=9)
            _upright(panel)
        _same_view(axes[0])
        return finished(figure, "figure-7-boxes", f"Figure 7: a ball at {series.case.variant} px/s into fifty boxes")


def errors_by_method(cells: Sequence[Cell], trials: Sequence[Trial], name: str, title: str) -> Drawn:
    """Figures 6 and 8: the error of every method, a panel for each setting: medians as bars, seeds as dots."""
    methods = list(dict.fromkeys(trial.method for trial in trials))
    columns = min(len(cells), 3)
    rows = -(-len(cells) // columns)
    with drawing(1.6 + 3.1 * columns, 0.8 + rows * (0.5 + 0.2 * len(methods)), rows, columns) as (figure, axes):
        for panel in axes.ravel()[len(cells) :]:
            panel.set_visible(False)
        for panel, cell in zip(axes.ravel(), cells, strict=False):
            _bars(panel, cell, methods, [trial for trial in trials if _belongs(trial, cell)])
        for panel in axes[:, 1:].ravel():
            panel.set_yticklabels([])
        return finished(figure, name, title)


def _bars(panel: Axes, cell: Cell, methods: list[str], trials: list[Trial]) -> None:
    for place, method in enumerate(methods):
        dots = [max(trial.mse, 1e-12) for trial in trials if trial.method == method]
        if method in cell.mse:
            panel.plot([max(cell.mse[method], 1e-12)] * 2, [place - 0.35, place + 0.35], color=colour_of(method), lw=3)
            panel.plot(dots, [place] * len(dots), "o", color=colour_of(method), ms=3.5, alpha=0.6)
    panel.axvline(cell.mse["linear"], color=LINE, lw=1, zorder=0)
    panel.set_xscale("log")
    panel.set_yticks(range(len(methods)), methods)
    panel.invert_yaxis()
    panel.set_title(cell.setting, color=SOFT, fontsize=9)
    panel.set_xlabel("mse, px²")
    panel.grid(axis="x", color=LINE, lw=0.5)


def error_over_time(trials: Sequence[Trial], cell: Cell, name: str, title: str) -> Drawn:
    """Root mean square error at each withheld midpoint of one setting, the first seed."""
    there = [trial for trial in trials if _belongs(trial, cell)]
    first = min(trial.case.seed for trial in there)
    shown = _telling([trial for trial in there if trial.case.seed == first])
    with drawing(9.0, 4.0) as (figure, axes):
        panel = axes[0, 0]
        for trial, (colour, style) in shown:
            panel.plot(trial.t, trial.error.clip(LEAST_DRAWN), style, color=colour, lw=1.5, label=trial.method)
        panel.set(yscale="log", xlabel="time, s", ylabel="error at the midpoint, px")
        panel.grid(axis="y", color=LINE, lw=0.5)
        panel.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        return finished(figure, name, f"{title} ({cell.setting})")


def loss_curves(trials: Sequence[Trial], name: str, title: str) -> Drawn:
    """The least loss so far beside the first one: every network has a loss of its own."""
    columns = min(len(trials), 4)
    rows = -(-len(trials) // columns)
    with drawing(1.0 + 2.3 * columns, 0.4 + 1.5 * rows, rows, columns) as (figure, axes):
        for panel in axes.ravel()[len(trials) :]:
            panel.set_visible(False)
        for panel, trial in zip(axes.ravel(), trials, strict=False):
            share = trial.loss / trial.loss[0]
            panel.plot(share, color=LINE, lw=1)
            panel.plot(np.fmin.accumulate(share), color=colour_of(trial.method), lw=1.5)
            panel.set(yscale="log")
            panel.set_title(trial.method, color=SOFT, fontsize=9)
        for panel in axes[-1]:
            panel.set_xlabel("step")
        for panel in axes[:, 0]:
            panel.set_ylabel("loss, first = 1")
        return finished(figure, name, title)


def _telling(trials: list[Trial]) -> list[tuple[Trial, tuple[str, str]]]:
    """Few enough to tell apart, the worst first: the simplest splines, the thesis' network, ConstraintNet, the best of
    the other networks, the physics."""
    looks = {"linear": (CURVE, ":"), "cubic": (CURVE, "--"), "akima": (CURVE, "-"), THESIS_NET: (THESIS, "-"),
             CONSTRAINT_NET: (RIVAL, "-"), PHYSICS_NAME: (PHYSICS, "-")}  # fmt: skip
    others = [trial for trial in trials if colour_of(trial.method) == NET and trial.method not in looks]
    if others:
        looks[min(others, key=lambda trial: trial.mse).method] = (NET, "-")
    chosen = sorted((trial for trial in trials if trial.method in looks), key=lambda trial: -trial.mse)
    return [(trial, looks[trial.method]) for trial in chosen]


def _belongs(trial: Trial, cell: Cell) -> bool:
    return setting_of(trial) == (cell.scene, cell.variant, cell.fps, cell.noise)


def _upright(panel: Axes) -> None:
    """y down and equal scales, as in a picture."""
    panel.set_aspect("equal")
    panel.invert_yaxis()
    panel.tick_params(labelsize=7)


def _same_view(panels: Sequence[Axes]) -> None:
    """The widest view for all."""
    wide, tall = (np.array([getattr(panel, f"get_{axis}lim")() for panel in panels]) for axis in "xy")
    for panel in panels:
        panel.set_xlim(wide.min(), wide.max())
        panel.set_ylim(tall.max(), tall.min())
