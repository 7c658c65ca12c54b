"""The commands of the program, one file each; importing a file adds its command to the command line."""

from __future__ import annotations

import ast
from pathlib import Path

from models.core.module_discovery import load_module
from pipeline.terminal.command_line import app

# Names of the commands in the order of `--help`: as a new user needs them.
COMMAND_NAMES = (
    "app", "check", "run", "batch", "view", "edit", "call", "compare", "what-if", "predict", "put-back", "interpolate",
    "diagnose", "gapcheck", "fit-table", "certify", "convert", "simulate", "detect", "train-detector", "reproduce",
    "graph", "cache",
)  # fmt: skip


def load_command(name: str) -> None:
    """Add one command to `app`, so that it need not wait for the imports of the others.

    Args:
        name: Name of the command. For any other word all commands are added with their summaries only, which is enough
            for `trueroll --help`.
    """
    loaded = [command for command in app.registered_commands if command.callback is not _raise_not_loaded]
    app.registered_commands[:] = loaded
    if name in COMMAND_NAMES:
        load_module("pipeline.cli.commands", f"{name.replace('-', '_')}_command")
        return
    for other in COMMAND_NAMES:
        if other not in {command.name for command in loaded}:
            app.command(other, help=read_summary(other))(_raise_not_loaded)
    app.registered_commands.sort(key=lambda command: COMMAND_NAMES.index(str(command.name)))


def read_summary(name: str) -> str:
    """Read the summary of a command from its source, because importing it may take a second.

    Args:
        name: Name of the command.

    Returns:
        First paragraph of the docstring of the first public function in its file, which is the command.
    """
    (path,) = Path(__file__).parent.glob(f"{name.replace('-', '_')}_command.py")
    source = path.read_text(encoding="utf-8")
    functions = (node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef))
    command = next(function for function in functions if not function.name.startswith("_"))
    return (ast.get_docstring(command) or "").partition("\n\n")[0]


def _raise_not_loaded() -> None:
    """Stand in for a command that is listed but not loaded."""
    raise AssertionError("a command is loaded by its name before it is called")
