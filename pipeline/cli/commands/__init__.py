"""The commands of the program, one file each; importing a file adds its command to the command line."""

from __future__ import annotations

import ast
from pathlib import Path

from pipeline.terminal.command_line import app

# Names of the commands in the order of `--help`: as a new user needs them.
COMMAND_NAMES = (
    "check", "run", "batch", "view", "edit", "call", "compare", "what-if", "predict", "put-back", "interpolate",
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
        _import_command(name)
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


def _import_command(name: str) -> None:
    """Import the file of a command. Imports are static here, so that tools see them."""
    match name:
        case "check":
            from pipeline.cli.commands import check_command as check_command
        case "run":
            from pipeline.cli.commands import run_command as run_command
        case "batch":
            from pipeline.cli.commands import batch_command as batch_command
        case "view":
            from pipeline.cli.commands import view_command as view_command
        case "edit":
            from pipeline.cli.commands import edit_command as edit_command
        case "call":
            from pipeline.cli.commands import call_command as call_command
        case "compare":
            from pipeline.cli.commands import compare_command as compare_command
        case "what-if":
            from pipeline.cli.commands import what_if_command as what_if_command
        case "predict":
            from pipeline.cli.commands import predict_command as predict_command
        case "put-back":
            from pipeline.cli.commands import put_back_command as put_back_command
        case "interpolate":
            from pipeline.cli.commands import interpolate_command as interpolate_command
        case "diagnose":
            from pipeline.cli.commands import diagnose_command as diagnose_command
        case "gapcheck":
            from pipeline.cli.commands import gapcheck_command as gapcheck_command
        case "fit-table":
            from pipeline.cli.commands import fit_table_command as fit_table_command
        case "certify":
            from pipeline.cli.commands import certify_command as certify_command
        case "convert":
            from pipeline.cli.commands import convert_command as convert_command
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
