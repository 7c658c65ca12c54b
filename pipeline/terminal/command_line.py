"""The typer application, its consoles, and the options that several commands take."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from inspect import BoundArguments, Parameter, Signature, cleandoc, signature
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, Union, get_args, get_origin

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from models.core.errors import OptionError

if TYPE_CHECKING:
    from models.core.answer import Answer
    from models.estimation.table_learning.learned_table import LearnedTable

app = typer.Typer(
    help="A clip of a billiards shot goes in; physics-true annotated slow motion comes out.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
console = Console(stderr=True, highlight=False)
P = ParamSpec("P")
AnyPath = str | PathLike[str]
"""A file or folder, as functions take it."""
_FILE_WIDTH = 10_000
"""Line width where the output is no terminal, in characters: wide enough not to break a path."""


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
        answer: The answer.
        as_json: Whether to print JSON.
    """
    from models.core.naming import join_names  # numpy is slow to import
    from pipeline.io.strict_json import format_strict_json

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
        print(f"Look at {join_names(answer.figures)}", flush=True)


def ignore_activity(activity: str) -> None:
    """Show nothing."""


def ignore_answer(answer: Answer) -> None:
    """Print nothing."""


def answer_command(name: str, **settings: Any) -> Callable[[Callable[P, Answer]], Callable[P, Answer]]:
    """Make a command of a public function of Python: one definition of its options, and its answer is printed.

    A parameter that is annotated for typer becomes an argument or option; `on_activity` is called with what is done,
    `on_answer` with each of several answers.

    Args:
        name: Name of the command.
        settings: Further settings of the command, as typer takes them.

    Returns:
        A decorator that returns the function as it is.
    """

    def decorate(function: Callable[P, Answer]) -> Callable[P, Answer]:
        whole = signature(function, eval_str=True)
        own = [one for one in whole.parameters.values() if get_origin(one.annotation) is Annotated]

        def command(*, as_json: bool, debug: bool, **values: Any) -> None:
            def show_answer(answer: Answer) -> None:
                print_answer(answer, as_json)

            with _show_activity("on_activity" in whole.parameters) as on_activity:
                given = BoundArguments(whole, OrderedDict(values, on_activity=on_activity, on_answer=show_answer))
                answer = function(*given.args, **given.kwargs)
            if "on_answer" not in whole.parameters:
                show_answer(answer)
            if answer.refusals:
                raise typer.Exit(1)

        flags = {"as_json": JsonOption, "debug": DebugOption}
        command.__signature__ = Signature(  # type: ignore[attr-defined]
            [_make_terminal_parameter(one) for one in own]
            + [Parameter(key, Parameter.KEYWORD_ONLY, default=False, annotation=kind) for key, kind in flags.items()]
        )
        command.__doc__ = cleandoc(function.__doc__ or "")
        described = "\n".join(f"    {one.name}: {get_args(one.annotation)[1].help}" for one in own)
        function.__doc__ = f"{command.__doc__}\n\nArgs:\n{described}"
        function.__signature__ = whole.replace(  # type: ignore[attr-defined]
            parameters=[
                one.replace(annotation=get_args(one.annotation)[0]) if one in own else one
                for one in whole.parameters.values()
            ]
        )
        app.command(name, **settings)(command)
        return function

    return decorate


def _show_activity(is_shown: bool) -> AbstractContextManager[Callable[[str], None]]:
    """Show activities on the console if the command has any."""
    if not is_shown:
        return nullcontext(ignore_activity)
    from pipeline.terminal.activity_display import show_activity  # numba is slow to import

    return show_activity(console)


def _make_terminal_parameter(one: Parameter) -> Parameter:
    """Make a parameter of the command line from one of Python."""
    kind, *notes = get_args(one.annotation)
    plain = _reduce_type(kind)
    annotation = Annotated[list[plain] if one.kind is Parameter.VAR_POSITIONAL else plain, *notes]  # type: ignore[valid-type]
    return one.replace(kind=Parameter.KEYWORD_ONLY, annotation=annotation)


def _reduce_type(kind: Any) -> Any:
    """Reduce the types that a function takes to the one that typer makes of words, and None."""
    options = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    origins = [get_origin(one) or one for one in options]
    if Sequence in origins:
        plain: Any = list[_reduce_type(get_args(options[origins.index(Sequence)])[0])]  # type: ignore[misc]
    elif PathLike in origins:
        plain = Path
    elif str in origins or Literal in origins:
        plain = str
    else:
        return kind
    return plain | None if type(None) in options else plain


ClipArgument = Annotated[Path, typer.Argument(help="A clip of a shot: mp4, mov, mkv, avi, webm.")]


def parse_output_path(text: str | Path) -> Path:
    """Parse the value of -o, which must not be empty: an empty path would mean the current folder.

    Args:
        text: The value.

    Returns:
        The path.

    Raises:
        OptionError: The value is empty.
    """
    if not str(text).strip():
        raise OptionError("-o, --out needs a name; an empty one was given")
    return Path(text)


def make_output_option(description: str, metavar: str = "PATH") -> Any:
    """Make the option `-o` of a command.

    Args:
        description: What it names, for the help.
        metavar: Kind of its value, for the help.

    Returns:
        The option.
    """
    return typer.Option("-o", "--out", parser=parse_output_path, metavar=metavar, help=description)


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


def read_learned_table(profile: AnyPath | None) -> LearnedTable | None:
    """Read what other shots taught about a table; None without a profile."""
    if profile is None:
        return None
    from pipeline.io.table_profile import parse_learned_table, read_profile_text  # slow to import

    return parse_learned_table(read_profile_text(Path(profile)))


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
