"""The results as files: trials.csv, a PNG for each figure, and one self-contained page."""

from __future__ import annotations

import csv
import io
from base64 import b64encode
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from pipeline.engine.atomic_write import aside
from pipeline.experiments.thesis.compared_methods import given
from pipeline.experiments.thesis.experiment_plan import SCENES, Plan, left_out, series_of, trained
from pipeline.experiments.thesis.scenes.boxes_scene import bodies
from pipeline.experiments.thesis.thesis_figures import (
    Drawn,
    boxes_series,
    error_over_time,
    errors_by_method,
    loss_curves,
    pendulum_series,
)
from pipeline.experiments.thesis.thesis_sentences import Cell, best, cells, sentences, setting_of, times
from pipeline.experiments.thesis.trials import Trial
from pipeline.reporting.pages.page_template import render

TITLES = {
    "double-pendulum": "Scene I: the double pendulum",
    "real": "Scene I, filmed: a real double pendulum",
    "boxes": "Scene II: a ball into fifty boxes",
    "pool": "Scene III: pool, from a real clip",
}
UNITS = {"double-pendulum": "{} springs", "real": "From {} on", "boxes": "A ball of {} px/s", "pool": "{}"}
"""What a variant of a scene is."""
MOST_PANELS = 9
"""of a figure."""


@dataclass(frozen=True, slots=True)
class Number:
    """One number of a table."""

    text: str
    look: str
    """best, worse than linear, or nothing."""


@dataclass(frozen=True, slots=True)
class Line:
    """One method of a table."""

    method: str
    cells: list[Number]


@dataclass(frozen=True, slots=True)
class Sheet:
    """How many times lower than linear every method is, a column for each rate and noise."""

    caption: str
    heads: list[str]
    rows: list[Line]


def write_results(plan: Plan, trials: Sequence[Trial], planned: int, folder: Path) -> None:
    """Write all files to `folder`; each appears whole or not at all."""
    found = cells(trials)
    figures = {scene: _figures(scene, found, trials, plan) for scene in SCENES}
    with aside(folder / "trials.csv") as path:
        path.write_text(as_csv(trials), encoding="utf-8")
    for drawn in [one for some in figures.values() for one in some]:
        with aside(folder / f"{drawn.name}.png") as path:
            path.write_bytes(drawn.png)
    with aside(folder / "reproduce.html") as path:
        path.write_text(_page(plan, trials, planned, found, figures), encoding="utf-8")


def as_csv(trials: Sequence[Trial]) -> str:
    """One row per trial, the columns of the contract first."""
    text = io.StringIO()
    rows = [trial.row for trial in trials]
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["scene"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def sheets(scene: str, found: list[Cell]) -> list[Sheet]:
    """A table for each variant of a scene."""
    here = [cell for cell in found if cell.scene == scene]
    variants = dict.fromkeys(cell.variant for cell in here)
    return [_sheet(variant, [cell for cell in here if cell.variant == variant]) for variant in variants]


def _sheet(variant: str, here: list[Cell]) -> Sheet:
    methods = list(dict.fromkeys(name for cell in here for name in cell.mse))
    heads = [f"{cell.fps:.3g} Hz, {cell.noise:g} px" for cell in here]
    first = Line("linear: mse, px²", [Number(f"{cell.mse['linear']:.3g}", "worse") for cell in here])
    rest = [Line(name, [_number(cell, name) for cell in here]) for name in methods if name != "linear"]
    name = UNITS[here[0].scene].format(variant)
    return Sheet(f"{name[0].upper()}{name[1:]}: how many times lower than linear", heads, [first, *rest])


def _number(cell: Cell, name: str) -> Number:
    if name not in cell.mse:
        return Number("-", "worse")
    gain = cell.mse["linear"] / max(cell.mse[name], 1e-300)
    leader = best(cell, cell.mse)
    look = "best" if leader is not None and leader[0] == name else "worse" if gain < 1 else ""
    return Number(times(gain) if gain >= 1e-3 else "lost", look)


def learning(scene: str, trials: Sequence[Trial]) -> Sheet | None:
    """What methods took in the first setting of a scene, where all of them are run: medians over the seeds."""
    here = [trial for trial in trials if trial.case.scene == scene]
    setting = setting_of(here[0]) if here else None
    by_method: dict[str, list[Trial]] = {}
    for trial in here:
        if setting_of(trial) == setting and trial.parameters:
            by_method.setdefault(trial.method, []).append(trial)
    if not by_method:
        return None
    rows = [Line(method, [Number(text, "") for text in _cost(some)]) for method, some in by_method.items()]
    return Sheet("What methods took to learn, in the first setting", ["numbers learnt", "steps", "CPU s"], rows)


def _cost(trials: list[Trial]) -> tuple[str, str, str]:
    numbers, steps = (int(median(values)) for values in (
        [trial.parameters for trial in trials], [len(trial.loss) for trial in trials]
    ))  # fmt: skip
    seconds = median(trial.seconds for trial in trials)
    return f"{numbers:,}", f"{steps:,}" if steps else "-", f"{seconds:.1f}"


def _figures(scene: str, found: list[Cell], trials: Sequence[Trial], plan: Plan) -> list[Drawn]:
    here = [trial for trial in trials if trial.case.scene == scene]
    if not here:
        return []
    settings = [cell for cell in found if cell.scene == scene][:MOST_PANELS]
    number = {"double-pendulum": "6", "boxes": "8"}.get(scene)
    name = f"figure-{number}-{scene}-errors" if number else f"{scene}-errors"
    kind = f"Figure {number}: error" if number else "Error"
    title = f"{kind} of every method; bars are medians over seeds, dots are seeds"
    middle = settings[len(settings) // 2]
    return [
        *_series(here[0], plan),
        errors_by_method(settings, here, name, title),
        error_over_time(here, middle, f"{scene}-error-over-time", "Error over time"),
        *_losses(scene, here),
    ]


def _losses(scene: str, here: Sequence[Trial]) -> list[Drawn]:
    case = here[0].case
    taught = [trial for trial in here if trial.case == case and len(trial.loss) > 1]
    title = (
        f"Loss of every network while it learns, the first seed ({case.variant}, {case.fps:.3g} Hz, {case.noise:g} px)"
    )
    return [loss_curves(taught, f"{scene}-loss", title)] if taught else []


def _series(trial: Trial, plan: Plan) -> list[Drawn]:
    if trial.case.scene == "double-pendulum":
        return [pendulum_series(series_of(trial.case, plan))]
    if trial.case.scene == "boxes":
        return [boxes_series(series_of(trial.case, plan), np.asarray(bodies()))]
    return []


def _page(plan: Plan, trials: Sequence[Trial], planned: int, found: list[Cell], figures: dict[str, list[Drawn]]) -> str:
    scenes = [
        {
            "title": TITLES[scene],
            "said": sentences(scene, found, plan.budget(scene).effort),
            "given": given(scene, {trial.method for trial in trials if trial.case.scene == scene}),
            "tables": [*sheets(scene, found), *filter(None, [learning(scene, trials)])],
            "figures": [{"title": one.title, "data": b64encode(one.png).decode()} for one in figures[scene]],
        }
        for scene in SCENES
        if any(cell.scene == scene for cell in found)
    ]
    return render(
        "reproduce.html",
        seeds=len({trial.case.seed for trial in trials}), trained=trained(plan),
        done=len(trials), planned=planned, left_out=left_out(plan), scenes=scenes, notes=_notes(trials),
    )  # fmt: skip


def _notes(trials: Sequence[Trial]) -> list[str]:
    """What methods said of their own motions, counted."""
    said = Counter((trial.case.scene, trial.case.variant, trial.method, trial.note) for trial in trials if trial.note)
    return [
        f"{scene}, {variant}, {method}: {note}{f' ({count} times)' if count > 1 else ''}"
        for (scene, variant, method, note), count in said.items()
    ]
