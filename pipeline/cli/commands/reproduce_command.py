"""`trueroll reproduce`: repeat the experiments of the thesis with all methods side by side."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as Grid

from models.core.errors import OptionError
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.engine.process_setup import available_cores
from pipeline.engine.result_cache import open_cache
from pipeline.terminal import command_line as cli

if TYPE_CHECKING:
    from pipeline.experiments.thesis.experiment_plan import ExperimentPlan
    from pipeline.experiments.thesis.thesis_results import ResultTable
    from pipeline.experiments.thesis.trials import Trial


PROGRESS_COLUMNS = (
    TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
    TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
)  # fmt: skip
# Text styles of cells.
LOOKS = {"best": "bold green", "worse": "dim"}
# Default folder of the recorded pendulum.
DEFAULT_DATA = Path("../shared/data/physics")


class ThesisScene(StrEnum):
    """Scenes of the experiments."""

    DOUBLE_PENDULUM = "double-pendulum"
    REAL = "real"
    BOXES = "boxes"
    POOL = "pool"


@cli.command("reproduce")
def reproduce(
    scene: Annotated[ThesisScene | None, typer.Argument()] = None,
    out: Annotated[Path, cli.OUT] = Path("out/reproduce"),
    quick: bool = False,
    whole: bool = False,
    seeds: Annotated[int | None, typer.Option(min=1)] = None,
    first_seed: Annotated[int, typer.Option(min=0)] = 0,
    data: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    run: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    jobs: Annotated[int | None, typer.Option(min=1)] = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Repeat the experiments of the thesis with all methods: a table, plots, a page; a second call resumes.

    Args:
        scene: One scene. Default: all of them.
        out: Folder of the results.
        quick: Run the settings of the thesis only, with and without noise, with one seed and few networks. Networks
            that are not trained to the end within 120 CPU s are marked and not compared.
        whole: Run all settings with all methods, trained to the end; this takes hours.
        seeds: Number of seeds. Default: 3, or 1 with --quick.
        first_seed: Seed of the first repetition; the others follow it.
        data: Folder that holds the recorded pendulum, at any depth.
        run: Folder of a run, for the pool scene.
        jobs: Number of processes. Default: one per core.
    """
    from pipeline.experiments.thesis.experiment_plan import SCENES, Depth, ExperimentPlan
    from pipeline.experiments.thesis.thesis_scenes import find_recording

    if quick and whole:
        raise OptionError("--quick and --whole ask for opposite things; give one of them")
    require_writable_folder(out)
    depth = Depth.QUICK if quick else Depth.WHOLE if whole else Depth.USUAL
    count = seeds if seeds is not None else 1 if quick else 3
    recorded = find_recording(data if data is not None else DEFAULT_DATA)
    plan = ExperimentPlan(
        (scene.value,) if scene else SCENES, tuple(range(first_seed, first_seed + count)), depth, recorded, run
    )
    trials = _run_trials(plan, open_cache(cache).root, out, jobs or available_cores())
    if as_json:
        print(json.dumps([trial.row for trial in trials], allow_nan=False))
    else:
        _print_experiments(plan, trials, out)


def _run_trials(plan: ExperimentPlan, cache: Path, out: Path, jobs: int) -> list[Trial]:
    from pipeline.experiments.thesis.experiment_plan import explain_omissions, list_tasks
    from pipeline.experiments.thesis.thesis_page import write_results
    from pipeline.experiments.thesis.trials import run_trials

    planned = list_tasks(plan)
    if not planned:
        raise OptionError(" ".join(explain_omissions(plan)))
    for sentence in explain_omissions(plan):
        cli.print_note(sentence)
    out.mkdir(parents=True, exist_ok=True)
    trials: list[Trial] = []
    with Progress(*PROGRESS_COLUMNS, console=cli.console, disable=not cli.console.is_terminal) as bars:
        bar = bars.add_task("trials", total=len(planned), note="")
        for trial in run_trials(plan, planned, cache, jobs):
            trials.append(trial)
            bars.update(bar, advance=1, note=f"{trial.case.scene} {trial.case.variant}, {trial.method}")
            if trial.case.seed != trials[0].case.seed and trial.case.seed != trials[-2].case.seed:
                write_results(plan, trials, len(planned), out)
    write_results(plan, trials, len(planned), out)
    return trials


def _print_experiments(plan: ExperimentPlan, trials: list[Trial], out: Path) -> None:
    from pipeline.experiments.thesis.compared_methods import describe_extra_inputs
    from pipeline.experiments.thesis.experiment_plan import describe_training
    from pipeline.experiments.thesis.thesis_page import TITLES
    from pipeline.experiments.thesis.thesis_results import build_tables, describe_scene_results, summarize_settings

    screen = cli.make_output_console()
    summary = summarize_settings(trials)
    for scene in dict.fromkeys(cell.case.scene for cell in summary):
        screen.print(f"\n[bold]{escape(TITLES[scene])}[/]")
        for sentence in describe_scene_results(scene, summary, plan.budget(scene).effort):
            screen.print(escape(sentence), soft_wrap=True)
        for sheet in build_tables(scene, summary):
            screen.print(_build_grid(sheet))
        screen.print(escape(describe_extra_inputs(scene, {trial.method for trial in trials})), soft_wrap=True)
    screen.print(f"\n{describe_training(plan)}", soft_wrap=True)
    print(f"Look at {out / 'reproduce.html'}; {out / 'trials.csv'} has every number.")


def _build_grid(sheet: ResultTable) -> Grid:
    """Build the table of a variant of a scene: methods down, frame rates and noises across."""
    grid = Grid(title=escape(sheet.caption), box=None, pad_edge=False, title_justify="left")
    grid.add_column("method", no_wrap=True)
    for head in sheet.heads:
        grid.add_column(head.replace(", ", "\n"), justify="right")
    for method, cells in sheet.rows:
        texts = [f"[{LOOKS[look]}]{text}[/]" if look else text for text, look in cells]
        grid.add_row(escape(method), *texts)
    return grid
