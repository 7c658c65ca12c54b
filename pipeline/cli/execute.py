"""One command line from its words to its exit status."""

from __future__ import annotations

import sys
import traceback
from typing import Any

import typer

from models.core.errors import OptionError
from pipeline.cli.commands import load
from pipeline.terminal.command_line import app

UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""Of the click that this typer uses: its own or the package."""


def execute(arguments: list[str]) -> int:
    """Run one command line; the exit status: 0 all went well, 1 some of it failed, 2 wrong usage."""
    try:
        load(arguments[0] if arguments else "")
        status = app(arguments or ["--help"], standalone_mode=False) or 0
        sys.stdout.flush()
    except Exception as error:
        status = _fail(error, "--debug" in arguments)
    return int(status)


def _fail(error: Exception, debug: bool) -> int:
    """Say in one line what went wrong; the exit status."""
    if debug:
        traceback.print_exception(error)
    if isinstance(error, UsageError):
        print(f"trueroll: {_usage(error)}", file=sys.stderr)
        return 2
    from pipeline.reporting.text.sentences import one_sentence

    print(f"trueroll: {one_sentence(error)}", file=sys.stderr)
    return 2 if isinstance(error, OptionError) else 1


def _usage(error: Any) -> str:
    context = error.ctx.command_path if error.ctx else "trueroll"
    return f"{' '.join(error.format_message().split()).rstrip('.')}; see {context} --help"
