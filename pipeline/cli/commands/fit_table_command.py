"""`trueroll fit-table`: learn the physics of one table from many shots."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from models.estimation.table_learning.rebound_summary import fit_restitution_formula
from pipeline.actions.fit_table import FittedTable, fit_table_of_shots
from pipeline.engine.helper_executor import open_executor
from pipeline.engine.result_cache import open_cache
from pipeline.io.learned_profile import name_pooltool_file, write_learned_profile
from pipeline.io.view_profile import collect_views
from pipeline.reporting.figures.cushion_figures import write_cushion_page
from pipeline.reporting.text.number_format import format_measured
from pipeline.terminal import command_line as cli
from pipeline.terminal.activity_display import show_shot_fits


@cli.app.command("fit-table")
def fit_table(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="DIR|tracks.csv...", help="Run folders or track folders of one table, all their shots."),
    ],
    out: Annotated[Path, cli.make_output_option("The profile to write.", "FILE")] = Path("profile.json"),
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
    debug: cli.DebugOption = False,
) -> None:
    """Learn one table from many shots, for `--profile` of `run`, `call`, `predict` and `simulate`.

    The fit of every shot is cached, so that a second call resumes, and a larger one continues.
    """
    store = open_cache(cache)
    out.parent.mkdir(parents=True, exist_ok=True)
    with open_executor() as executor, show_shot_fits(cli.console, "learning the table") as show:
        fitted = fit_table_of_shots(inputs, store, executor, show)
    left_out = write_learned_profile(fitted.lesson, fitted.table, fitted.shot_count, out, collect_views(inputs))
    page = out.with_suffix(".html")
    write_cushion_page(fitted.lesson.table, fitted.table, page)
    if as_json:
        print(json.dumps({"profile": str(out), "refused": list(fitted.refusals), **json.loads(out.read_text())}))
    else:
        _print_table(fitted, out, left_out)
        print(f"What the cushions do, beside published models: {page}")


def _print_table(fitted: FittedTable, path: Path, left_out: tuple[str, ...]) -> None:
    screen, lesson = cli.make_output_console(), fitted.lesson
    (best, evidence), *others = lesson.candidates
    lead = f", {evidence - others[0][1]:.0f} ahead in log evidence" if others else ""
    screen.print(
        escape(f"{fitted.shot_count} shots with {lesson.contact_count} cushion contacts: cushion model {best}{lead}")
    )
    grid = Grid("parameter", "value", "sigma", "unit", "", box=None, pad_edge=False)
    for one in lesson.parameters:
        note = "not identifiable: the prior" if one.prior_only else ""
        grid.add_row(one.name, *format_measured(one.value, one.sigma), one.unit, note)
    screen.print(grid)
    scatter = lesson.table.scatter
    screen.print(
        f"Cushions scatter about the model by {scatter.velocity:.1%} of the speed (slip {scatter.slip:.1%},"
        f" side spin {scatter.side_spin:.1%})"
    )
    if lesson.correction_gain is None:
        screen.print("Too few cushion contacts to train a correction of the cushion model")
    else:
        state = "on" if len(lesson.table.correction) else "off"
        screen.print(
            f"On shots that it has not seen, a network removes {lesson.correction_gain:.0%} of the squared deviation"
            f" from the cushion model: switched {state}"
        )
    _print_formula(fitted, screen)
    for refusal in fitted.refusals:
        screen.print(escape(f"Note: {refusal}"))
    screen.print(
        escape(f"{name_pooltool_file(path)} holds the table for pooltool, which has no {', no '.join(left_out)}")
    )
    print(f"The next prediction on this table can start from it: trueroll predict DIR --profile {path}")


def _print_formula(fitted: FittedTable, screen: Console) -> None:
    """Print a short formula of the restitution, and whether it does as well as the learned model."""
    learned, table = fitted.lesson.table, fitted.table
    formula = fit_restitution_formula(learned, table.ball_radius, table.ball_mass)
    scatter = learned.scatter.velocity
    verdict = "does as well" if formula.misfit <= scatter else "does not do as well"
    screen.print(
        f"Restitution {formula.factor:.3f} v^{-formula.power:+.3f} (v into the cushion in m/s) {verdict}: it deviates"
        f" from the learned cushion by {formula.misfit:.1%} of the speed, contacts scatter by {scatter:.1%}"
    )
