"""The commands of the program, a file each; importing one adds it to `app`."""

from __future__ import annotations

from pipeline.command_line import app
from pipeline.commands import batch, cache, call, detect, diagnose, graph, predict, run, simulate, train_detector, view

__all__ = [
    "app",
    "batch",
    "cache",
    "call",
    "detect",
    "diagnose",
    "graph",
    "predict",
    "run",
    "simulate",
    "train_detector",
    "view",
]

_ORDER = (
    "run",
    "batch",
    "view",
    "call",
    "predict",
    "diagnose",
    "simulate",
    "detect",
    "train-detector",
    "graph",
    "cache",
)
"""As a new user needs them, in the list of `--help`."""

app.registered_commands.sort(key=lambda command: _ORDER.index(str(command.name)))
