"""`trueroll compare`: the shots of a session as a table and plots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table as Grid

from models.core.errors import OptionError
from pipeline.actions.compare_session import GROUPINGS, ComparedSession, compare_session, write_session
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.strict_json import format_strict_json
from pipeline.reporting.pages.session_page import MAIN_NUMBERS
from pipeline.reporting.text.session_sentences import format_level, format_own_spread, format_trend, name_number
from pipeline.reporting.text.text_formatting import name_folders
from pipeline.terminal import command_line as cli


@cli.app.command("compare")
def compare(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Run folders, or folders of run folders, such as a batch.")
    ],
    out: Annotated[Path, cli.make_output_option("Folder of the results, which is none of DIR.")] = Path("out/session"),
    group: Annotated[
        str,
        typer.Option(
            "--group",
            help="What the shots of a group share: folder (of the command line), spin (at the first ball), ball"
            " (that is hit first), pocket, side (of the cut).",
        ),
    ] = "folder",
    as_json: cli.JsonOption = False,
    debug: cli.DebugOption = False,
) -> None:
    """Compare the shots of a session: level, spread and trend of every number, as a page, CSV and Parquet."""
    if group not in GROUPINGS:
        raise OptionError(f"--group is one of {', '.join(GROUPINGS)}; got {group}")
    require_writable_folder(out)
    session = compare_session(folders, group)
    document = write_session(session, f"{len(session.columns['number'])} shots of {name_folders(folders)}", out)
    if as_json:
        print(format_strict_json({"folder": str(out), **document}))
    else:
        _print_session(session, out)
    for repetition in session.repetitions:
        cli.console.print(f"Note: {repetition}", markup=False, soft_wrap=True)
    if session.refusals:
        for refusal in session.refusals:
            cli.console.print(f"Left out: {refusal}", markup=False, soft_wrap=True)
        raise typer.Exit(1)


def _print_session(session: ComparedSession, out: Path) -> None:
    grid = Grid("number", "shots", "median", "own spread", "unit", "trend per shot", box=None, pad_edge=False)
    for one in session.summaries[""]:
        if one.count and one.name in MAIN_NUMBERS:
            grid.add_row(
                escape(name_number(one.name)), str(one.count), format_level(one), format_own_spread(one), one.unit,
                format_trend(one),
            )  # fmt: skip
    cli.make_output_console().print(grid)
    print(f"Look at {out / 'session.html'}")
