"""trueroll reproduce: the experiments of the thesis, every method side by side."""

from __future__ import annotations

import json
import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from models.core.errors import OptionError
from pipeline.chain import refuse_closed
from pipeline.terminal.command_line import (
    CacheOption,
    DebugOption,
    JsonOption,
    app,
    console,
    named,
    open_cache,
    standard_output,
)

if TYPE_CHECKING:
    from pipeline.experiments.thesis.experiment_plan import Plan
    from pipeline.experiments.thesis.trials import Trial


BAR = (
    TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
    TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
)  # fmt: skip
USUAL_DATA = Path("../shared/data/physics")
"""Where the recorded pendulum is looked for if nothing is said."""


class Scene(StrEnum):
    """What can be asked for."""

    DOUBLE_PENDULUM = "double-pendulum"
    REAL = "real"
    BOXES = "boxes"
    POOL = "pool"


@app.command("reproduce")
def reproduce(
    scene: Annotated[Scene | None, typer.Argument(help="One scene; all of them where not given.")] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", parser=named, metavar="PATH", help="Folder of the results.")
    ] = Path("out/reproduce"),
    quick: Annotated[
        bool, typer.Option("--quick", help="The settings of the thesis, one seed, one method of each kind.")
    ] = False,
    whole: Annotated[
        bool, typer.Option("--whole", help="All settings crossed with all methods, trained to the end: hours.")
    ] = False,
    seeds: Annotated[int | None, typer.Option("--seeds", min=1, help="How many; 3, one with --quick.")] = None,
    first_seed: Annotated[int, typer.Option("--first-seed", min=0, help="The number of the first.")] = 0,
    data: Annotated[
        Path | None, typer.Option("--data", metavar="DIR", help="Folder at or below which the recorded pendulum lies.")
    ] = None,
    run: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="Folder of `trueroll run`: the pool scene.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="Processes at a time; as many as there are cores.")
    ] = None,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """The thesis' experiments with every method side by side: a table, plots, a page; run again, it resumes."""
    from pipeline.experiments.thesis.experiment_plan import SCENES, Depth, Plan
    from pipeline.experiments.thesis.scenes.double_pendulum_scene import recording_in

    if quick and whole:
        raise OptionError("--quick and --whole ask for opposite things; give one of them")
    refuse_closed(out)
    depth = Depth.QUICK if quick else Depth.WHOLE if whole else Depth.USUAL
    count = seeds if seeds is not None else 1 if quick else 3
    recorded = recording_in(data if data is not None else USUAL_DATA)
    plan = Plan((scene.value,) if scene else SCENES, tuple(range(first_seed, first_seed + count)), depth, recorded, run)
    trials = _carry_out(plan, open_cache(cache).root, out, jobs or len(os.sched_getaffinity(0)))
    if as_json:
        print(json.dumps([trial.row for trial in trials], allow_nan=False))
    else:
        _tell(plan, trials, out)


def _carry_out(plan: Plan, cache: Path, out: Path, jobs: int) -> list[Trial]:
    from pipeline.experiments.thesis.experiment_plan import left_out, tasks
    from pipeline.experiments.thesis.thesis_page import write_results
    from pipeline.experiments.thesis.trial_processes import carried_out

    planned = tasks(plan)
    if not planned:
        raise OptionError(" ".join(left_out(plan)))
    out.mkdir(parents=True, exist_ok=True)
    trials: list[Trial] = []
    with Progress(*BAR, console=console, disable=not console.is_terminal) as bars:
        bar = bars.add_task("trials", total=len(planned), note="")
        for trial in carried_out(plan, planned, cache, jobs):
            trials.append(trial)
            bars.update(bar, advance=1, note=f"{trial.case.scene} {trial.case.variant}, {trial.method}")
            if trial.case.seed != trials[0].case.seed and trial.case.seed != trials[-2].case.seed:
                write_results(plan, trials, len(planned), out)
    write_results(plan, trials, len(planned), out)
    return trials


def _tell(plan: Plan, trials: list[Trial], out: Path) -> None:
    from pipeline.experiments.thesis.compared_methods import given
    from pipeline.experiments.thesis.experiment_plan import left_out, trained
    from pipeline.experiments.thesis.terminal_tables import grids
    from pipeline.experiments.thesis.thesis_page import TITLES
    from pipeline.experiments.thesis.thesis_sentences import cells, sentences

    screen = standard_output()
    found = cells(trials)
    for scene in dict.fromkeys(cell.scene for cell in found):
        screen.print(f"\n[bold]{escape(TITLES[scene])}[/]")
        for sentence in sentences(scene, found, plan.budget(scene).effort):
            screen.print(escape(sentence), soft_wrap=True)
        for grid in grids(scene, found):
            screen.print(grid)
        screen.print(escape(given(scene, {trial.method for trial in trials})), soft_wrap=True)
    screen.print(f"\n{trained(plan)}", soft_wrap=True)
    for sentence in left_out(plan):
        screen.print(escape(sentence), soft_wrap=True)
    print(f"Look at {out / 'reproduce.html'}; {out / 'trials.csv'} has every number.")
