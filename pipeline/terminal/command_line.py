"""What the commands share: the program's name, and options that several of them take."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from models.core.errors import OptionError
from pipeline.engine.result_cache import Cache, default_root

app = typer.Typer(
    help="A clip of a billiards shot goes in; physics-true annotated slow motion comes out.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
console = Console(stderr=True, highlight=False)
_UNBROKEN = 10_000
"""columns of what is no terminal: no path is broken in two."""


def standard_output() -> Console:
    """Where answers go; lines are as long as they need to be where nobody reads them on a terminal."""
    own = Console(highlight=False)
    return own if own.is_terminal else Console(highlight=False, width=_UNBROKEN)


ClipArgument = Annotated[Path, typer.Argument(help="A clip of a shot: mp4, mov, mkv, avi, webm.")]


def named(text: str | Path) -> Path:
    """A path that is not empty: an empty one would mean the folder one is in."""
    if not str(text).strip():
        raise OptionError("-o, --out needs a name; an empty one was given")
    return Path(text)


OutOption = Annotated[
    Path | None,
    typer.Option(
        "-o", "--out", parser=named, metavar="PATH", help="Folder of the results; out/<clip> where not given."
    ),
]
CacheOption = Annotated[
    Path | None, typer.Option("--cache", help="Cache folder; $TRUEROLL_CACHE, else ~/.cache/trueroll where not given.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show where an error comes from.")]


def open_cache(folder: Path | None) -> Cache:
    root = folder if folder is not None else default_root()
    try:
        return Cache(root)
    except OSError as error:
        raise OptionError(f"The cache needs a folder that can be written; {root}: {error.strerror}") from error


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"trueroll {version('trueroll')}")
        raise typer.Exit


@app.callback()
def _common(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    return None


def with_settings(function: Callable[..., None]) -> Callable[..., None]:
    """The command with the option of every stage appended, as one `options` argument."""
    return with_settings_but(())(function)


def with_settings_but(without: Collection[str]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The same for a command that some options, by their names, mean nothing to."""

    def decorated(function: Callable[..., None]) -> Callable[..., None]:
        return _with_settings(function, without)

    return decorated


def _with_settings(function: Callable[..., None], without: Collection[str]) -> Callable[..., None]:
    from pipeline.options import collect, parameters  # what the stages need is heavy, and not every command takes it

    own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "options"]
    names = {p.name for p in own}
    extra = parameters(without)

    def command(**values: Any) -> None:
        options = collect({p.name: values[p.name] for p in extra})
        function(**{name: values[name] for name in names}, options=options)

    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + extra
    )
    command.__annotations__ = {p.name: p.annotation for p in [*own, *extra]}
    command.__doc__ = function.__doc__
    return command
