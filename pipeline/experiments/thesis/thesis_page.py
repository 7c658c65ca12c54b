"""The results as files: trials.csv, and one self-contained page with tables and figures."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from pipeline.engine.atomic_write import write_text
from pipeline.experiments.thesis.compared_methods import describe_extra_inputs
from pipeline.experiments.thesis.experiment_plan import (
    SCENES,
    ExperimentPlan,
    build_case_series,
    describe_training,
    explain_omissions,
)
from pipeline.experiments.thesis.scenes.boxes_scene import body_indices
from pipeline.experiments.thesis.thesis_figures import (
    ThesisFigure,
    plot_boxes_series,
    plot_error_over_time,
    plot_errors_by_method,
    plot_loss_curves,
    plot_pendulum_series,
)
from pipeline.experiments.thesis.thesis_sentences import (
    SettingResult,
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
UNITS = {"double-pendulum": "{} springs", "real": "From {} on", "boxes": "A ball of {} px/s", "pool": "{}"}
"""Name of a variant of a scene."""
MAX_PANELS = 9
"""Largest number of panels of a figure."""


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
    """Build a table for each variant of a scene."""
    here = [cell for cell in results if cell.scene == scene]
    variants = dict.fromkeys(cell.variant for cell in here)
    return [_build_table(variant, [cell for cell in here if cell.variant == variant]) for variant in variants]


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
        *_plot_losses(scene, here),
    ]


def _plot_losses(scene: str, here: Sequence[Trial]) -> list[ThesisFigure]:
    case = here[0].case
    trained = [trial for trial in here if trial.case == case and len(trial.loss) > 1]
    title = (
        f"Loss of every network while it learns, the first seed ({case.variant}, {case.fps:.3g} Hz, {case.noise:g} px)"
    )
    return [plot_loss_curves(trained, f"{scene}-loss", title)] if trained else []


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
