"""Runs one command line and reports its errors."""

from __future__ import annotations

import logging
import sys
import traceback
from typing import Any

import typer

from models.core.errors import OptionError
from pipeline.cli.commands import load_command
from pipeline.terminal.command_line import app

# Base class of usage errors in the click that this typer uses: its own copy or the package.
UsageError: type[Exception] = typer.BadParameter.__bases__[0]


def execute_command_line(arguments: list[str]) -> int:
    """Run one command line.

    Args:
        arguments: The words after the name of the program.

    Returns:
        The exit status: 0 success, 1 some of it failed, 2 wrong usage.
    """
    if "--debug" in arguments:
        _show_fit_log()
    try:
        load_command(arguments[0] if arguments else "")
        status = app(arguments or ["--help"], standalone_mode=False) or 0
        sys.stdout.flush()
    except Exception as error:
        status = _report_error(error, "--debug" in arguments)
    return int(status)


def _show_fit_log() -> None:
    """Print the cost before and after each pass of a fit that runs; one from the cache has none."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    logger = logging.getLogger("trueroll")
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)


def _report_error(error: Exception, debug: bool) -> int:
    """Print an error as one line and return the exit status."""
    if debug:
        traceback.print_exception(error)
    if isinstance(error, UsageError):
        usage: Any = error
        message = _format_validation_error(error) or " ".join(usage.format_message().split()).rstrip(".")
        command = usage.ctx.command_path if usage.ctx else "trueroll"
        print(f"trueroll: {message}; see {command} --help", file=sys.stderr)
        return 2
    from pipeline.reporting.text.text_formatting import format_error

    print(f"trueroll: {format_error(error)}", file=sys.stderr)
    return 2 if isinstance(error, OptionError) else 1


def _format_validation_error(error: Any) -> str:
    """Format a value that typer's validation (pydantic) refused, e.g. `--at is a number; got T`; else empty."""
    list_errors = getattr(error.__cause__, "errors", None)
    option = getattr(getattr(error, "param", None), "opts", None)
    if list_errors is None or not option:
        return ""
    refused = list_errors()[0]
    limit = refused["msg"].partition(",")[0].replace("Input should be", "is")
    limit = limit.replace("valid integer", "whole number").replace("valid ", "")
    return f"{option[-1]} {limit}; got {refused['input']}"
