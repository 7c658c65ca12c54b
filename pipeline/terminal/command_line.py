"""The typer application, its consoles, and the options that several commands take."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from models.core.answer import Answer
from pipeline.engine.atomic_write import parse_output_path

app = typer.Typer(
    help="A clip of a billiards shot goes in; physics-true annotated slow motion comes out.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
console = Console(stderr=True, highlight=False)
# A file or folder, as functions take it.
AnyPath = str | PathLike[str]
# Line width where the output is no terminal, in characters: wide enough not to break a path.
_FILE_WIDTH = 10_000


def make_output_console() -> Console:
    """Make the console for results on standard output.

    Returns:
        A console that breaks lines only on a terminal.
    """
    output = Console(highlight=False)
    return output if output.is_terminal else Console(highlight=False, width=_FILE_WIDTH)


def print_answer(answer: Answer, as_json: bool) -> None:
    """Print an answer: its document as one line of JSON, or its sentences, its table and where to look.

    Args:
        as_json: Whether to print JSON.
    """
    from pipeline.io.strict_json import format_strict_json  # numpy is slow to import

    for refusal in answer.refusals:
        console.print(f"Left out: {refusal}", markup=False, soft_wrap=True)
    if as_json:
        print(format_strict_json(answer.document, indent=None), flush=True)
        return
    screen = make_output_console()
    for sentence in answer.sentences:
        screen.print(escape(sentence))
    if answer.rows:
        grid = Grid(*(escape(heading) for heading in answer.rows[0]), box=None, pad_edge=False)
        for row in answer.rows[1:]:
            grid.add_row(*(escape(cell) for cell in row))
        screen.print(grid)
    for note in answer.notes:
        screen.print(escape(note))
    if answer.figures:
        print(f"Look at {' and '.join(answer.figures)}", flush=True)


ClipArgument = Annotated[Path, typer.Argument(help="A clip of a shot: mp4, mov, mkv, avi, webm.")]


def make_output_option(description: str, metavar: str = "PATH") -> Any:
    """Make the option `-o` of a command.

    Args:
        description: What it names, for the help.
        metavar: Kind of its value, for the help.

    Returns:
        The option.
    """
    return typer.Option("-o", "--out", parser=parse_output_path, metavar=metavar, help=description)


ShotOption = Annotated[
    int | None,
    typer.Option("--shot", help="Number of the shot in a recording. Default: the longest.", min=1),
]
ShotTimeOption = Annotated[
    float | None, typer.Option("--at", help="A time in the shot, in s of the recording, instead of --shot.", min=0.0)
]
OutOption = Annotated[Path | None, make_output_option("Folder of the results. Default: out/<clip>.")]
OutBesideOption = Annotated[AnyPath | None, make_output_option("Folder of the results. Default: DIR.")]
_CACHE = typer.Option("--cache", help="Folder of the cache. Default: $TRUEROLL_CACHE, else ~/.cache/trueroll.")
CacheOption = Annotated[Path | None, _CACHE]
AnyCacheOption = Annotated[AnyPath | None, _CACHE]
ProfileOption = Annotated[
    AnyPath | None,
    typer.Option("--profile", metavar="FILE", help="What trueroll fit-table or diagnose learned about this table."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
DebugOption = Annotated[
    bool,
    typer.Option("--debug", help="Print the traceback of an error, and the cost before and after each pass of a fit."),
]


def _print_version(is_requested: bool) -> None:
    """Print the version and exit if it is requested."""
    if is_requested:
        from importlib.metadata import version

        print(f"trueroll {version('trueroll')}")
        raise typer.Exit


@app.callback()
def _add_common_options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options that come before a command."""
