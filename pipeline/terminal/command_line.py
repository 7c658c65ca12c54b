"""The typer application, its consoles, and the options that several commands take."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import partial
from inspect import Parameter, Signature, cleandoc, signature
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid
from typer.models import OptionInfo

from models.core.answer import Answer
from pipeline.engine.atomic_write import parse_output_path

app = typer.Typer(
    help="A clip of a billiards shot or a rally goes in; physics-true annotated slow motion comes out.",
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


def print_rows(
    headings: Iterable[str], rows: Iterable[Iterable[str]], narrow_columns: Sequence[int] | None = None
) -> None:
    """Print a table on standard output; its cells are markup of rich.

    Args:
        narrow_columns: Columns that a screen shows which is too narrow for all; None for all.
    """
    screen, table = make_output_console(), [tuple(headings), *map(tuple, rows)]
    grid = _build_grid(table)
    natural = screen.measure(grid, options=screen.options.update(max_width=_FILE_WIDTH)).maximum
    if narrow_columns is not None and natural > screen.width:
        grid = _build_grid([tuple(row[k] for k in narrow_columns) for row in table])
    screen.print(grid)


def _build_grid(table: Sequence[Sequence[str]]) -> Grid:
    """Build what rich prints of headings and rows."""
    grid = Grid(*table[0], box=None, pad_edge=False)
    for row in table[1:]:
        grid.add_row(*row)
    return grid


def print_note(sentence: str) -> None:
    """Print a sentence beside the results, on standard error."""
    console.print(sentence, markup=False, soft_wrap=True)


def print_answer(answer: Answer, as_json: bool) -> None:
    """Print an answer: its document as one line of JSON, or its sentences, its table and where to look.

    Args:
        as_json: Whether to print JSON.
    """
    from pipeline.io.strict_json import format_strict_json  # numpy is slow to import

    for refusal in answer.refusals:
        print_note(f"Left out: {refusal}")
    if as_json:
        print(format_strict_json(answer.document, indent=None), flush=True)
        return
    screen = make_output_console()
    for sentence in answer.sentences:
        screen.print(escape(sentence))
    if answer.rows:
        headings, *rows = (map(escape, row) for row in answer.rows)
        print_rows(headings, rows)
    for note in answer.notes:
        screen.print(escape(note))
    if answer.figures:
        print(f"Look at {' and '.join(answer.figures)}", flush=True)


# The option -o of a command, with the kind of its value for the help.
make_output_option = partial(typer.Option, "-o", "--out", parser=parse_output_path)
OUT = make_output_option(metavar="PATH")
_BESIDE = "Folder of the results. Default: DIR."
OutBesideOption = Annotated[
    AnyPath | None, make_output_option(metavar="PATH", help="Folder of the results. Default: DIR.")
]
_CACHE = typer.Option(help="Folder of the cache. Default: $TRUEROLL_CACHE, else ~/.cache/trueroll.")
CacheOption = Annotated[Path | None, _CACHE]
AnyCacheOption = Annotated[AnyPath | None, _CACHE]
ProfileOption = Annotated[
    AnyPath | None, typer.Option(metavar="FILE", help="What trueroll fit-table or diagnose learned about this table.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
DebugOption = Annotated[
    bool, typer.Option(help="Print the traceback of an error, and the cost before and after each pass of a fit.")
]


def command(name: str, **settings: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function: its docstring describes the command, and the docstring's `Args` the options.

    A parameter with a default becomes an option of the same name, another one an argument. `--debug` is added.

    Args:
        name: Name of the command.
        settings: Further settings of the command, as typer takes them.

    Returns:
        A decorator that returns the function as it is.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        text, sentences = split_docstring(function)
        own = signature(function, eval_str=True).parameters.values()
        debug = Parameter("debug", Parameter.KEYWORD_ONLY, default=False, annotation=DebugOption)

        def run(*, debug: bool, **values: Any) -> None:
            function(**values)

        run.__doc__ = text
        run.__signature__ = Signature(  # type: ignore[attr-defined]
            [_make_terminal_parameter(one, sentences.get(one.name)) for one in (*own, debug)]
        )
        app.command(name, **settings)(run)
        return function

    return decorate


def split_docstring(function: Callable[..., object]) -> tuple[str, dict[str, str]]:
    """Split the docstring of a command into its text and the sentences on its arguments, by name."""
    text, _, arguments = cleandoc(function.__doc__ or "").partition("\n\nArgs:\n")
    entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", arguments, re.MULTILINE)
    return text, {name: " ".join(words.split()) for name, words in entries}


def split_annotation(one: Parameter) -> tuple[Any, Any]:
    """Split the annotation of a parameter into its type and what typer is told of it."""
    if get_origin(one.annotation) is Annotated:
        kind, stated = get_args(one.annotation)
        return kind, copy(stated)
    return one.annotation, typer.Argument() if one.default is Parameter.empty else typer.Option()


def _make_terminal_parameter(one: Parameter, sentence: str | None) -> Parameter:
    """Make a parameter of the command line from one of Python."""
    kind, stated = split_annotation(one)
    stated.help = sentence or stated.help
    if isinstance(stated, OptionInfo) and stated.default is ...:
        stated.default = f"--{one.name.replace('_', '-')}"
    return one.replace(kind=Parameter.KEYWORD_ONLY, annotation=Annotated[kind, stated])


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
