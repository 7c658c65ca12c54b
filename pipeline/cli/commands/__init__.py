"""The commands of the program, a file each; importing one adds it to the command line."""

from __future__ import annotations

import ast
from pathlib import Path

from pipeline.terminal.command_line import app

ORDER = (
    "run", "batch", "view", "call", "predict", "interpolate", "diagnose", "gapcheck", "simulate", "detect",
    "train-detector", "reproduce", "graph", "cache",
)  # fmt: skip
"""As a new user needs them, in the list of `--help`."""


def load(wanted: str) -> None:
    """Add the command of this name to `app`: one need not wait for what others need.

    For any other word, the names of all with their first sentences, which is what `--help` shows.
    """
    loaded = [command for command in app.registered_commands if command.callback is not _not_loaded]
    app.registered_commands[:] = loaded
    if wanted in ORDER:
        _import(wanted)
        return
    for name in ORDER:
        if name not in {command.name for command in loaded}:
            app.command(name, help=first_sentence(name))(_not_loaded)
    app.registered_commands.sort(key=lambda command: ORDER.index(str(command.name)))


def first_sentence(name: str) -> str:
    """The docstring of the function behind a command, read from its source: importing it would take a second."""
    source = Path(__file__).with_name(f"{name.replace('-', '_')}_command.py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef) and any(_adds(decorator, name) for decorator in node.decorator_list):
            return (ast.get_docstring(node) or "").partition("\n\n")[0]
    raise ValueError(f"pipeline/commands/ has no function that adds the command {name}")


def _adds(decorator: ast.expr, name: str) -> bool:
    """Whether this is @app.command(name)."""
    return (
        isinstance(decorator, ast.Call)
        and ast.unparse(decorator.func) == "app.command"
        and [argument.value for argument in decorator.args if isinstance(argument, ast.Constant)] == [name]
    )


def _not_loaded() -> None:
    raise AssertionError("a command is loaded by its name before it is called")


def _import(name: str) -> None:
    """Each in a statement of its own: there are no dynamic imports here."""
    match name:
        case "run":
            from pipeline.cli.commands import run_command as run_command
        case "batch":
            from pipeline.cli.commands import batch_command as batch_command
        case "view":
            from pipeline.cli.commands import view_command as view_command
        case "call":
            from pipeline.cli.commands import call_command as call_command
        case "predict":
            from pipeline.cli.commands import predict_command as predict_command
        case "interpolate":
            from pipeline.cli.commands import interpolate_command as interpolate_command
        case "diagnose":
            from pipeline.cli.commands import diagnose_command as diagnose_command
        case "gapcheck":
            from pipeline.cli.commands import gapcheck_command as gapcheck_command
        case "simulate":
            from pipeline.cli.commands import simulate_command as simulate_command
        case "detect":
            from pipeline.cli.commands import detect_command as detect_command
        case "train-detector":
            from pipeline.cli.commands import train_detector_command as train_detector_command
        case "reproduce":
            from pipeline.cli.commands import reproduce_command as reproduce_command
        case "graph":
            from pipeline.cli.commands import graph_command as graph_command
        case "cache":
            from pipeline.cli.commands import cache_command as cache_command
