"""Adds the settings of a run to a command, as options of its command line."""

from __future__ import annotations

from collections.abc import Callable, Collection

from pipeline.run_options import build_options, list_settings
from pipeline.terminal.command_settings import append_settings


def add_settings(function: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command that takes the options of all stages as one `options` argument.

    Args:
        function: The command.

    Returns:
        The command with one option per setting on the command line.
    """
    return add_settings_except(())(function)


def add_settings_except(excluded: Collection[str]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command that takes the options of all stages except some.

    Args:
        excluded: Names of the settings that do not apply to the command.

    Returns:
        A decorator like `add_settings`.
    """
    settings = [setting for setting in list_settings().values() if setting.name not in excluded]
    return lambda function: append_settings(function, settings, build_options)
