"""The commands of the program, a file each; importing one adds it to the command line."""

from __future__ import annotations

from pipeline.command_line import app

ORDER = (
    "run", "batch", "view", "call", "predict", "diagnose", "simulate", "detect", "train-detector", "graph", "cache",
)  # fmt: skip
"""As a new user needs them, in the list of `--help`."""


def load(wanted: str) -> None:
    """Add the command of this name to `app`, all of them for any other word: one need not wait for what others need."""
    for name in [wanted] if wanted in ORDER else ORDER:
        _import(name)
    app.registered_commands.sort(key=lambda command: ORDER.index(str(command.name)))


def _import(name: str) -> None:
    """Each in a statement of its own: there are no dynamic imports here."""
    match name:
        case "run":
            from pipeline.commands import run as run
        case "batch":
            from pipeline.commands import batch as batch
        case "view":
            from pipeline.commands import view as view
        case "call":
            from pipeline.commands import call as call
        case "predict":
            from pipeline.commands import predict as predict
        case "diagnose":
            from pipeline.commands import diagnose as diagnose
        case "simulate":
            from pipeline.commands import simulate as simulate
        case "detect":
            from pipeline.commands import detect as detect
        case "train-detector":
            from pipeline.commands import train_detector as train_detector
        case "graph":
            from pipeline.commands import graph as graph
        case "cache":
            from pipeline.commands import cache as cache
