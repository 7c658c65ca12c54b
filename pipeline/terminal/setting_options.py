"""Adds the settings of a run to a command, as options of its command line."""

from __future__ import annotations

from collections.abc import Callable, Collection

from pipeline.run_options import build_options, list_settings
from pipeline.terminal.command_settings import append_settings


def add_settings(excluded: Collection[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command that takes the options of all stages as one `options` argument.

    Args:
        excluded: Names of the settings that do not apply to the command.

    Returns:
        A decorator, which adds one option per setting to the command line.
    """
    settings = [setting for setting in list_settings().values() if setting.name not in excluded]
    return lambda function: append_settings(function, settings, build_options)
