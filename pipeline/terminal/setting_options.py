"""Adds the settings of a run to a command, as options of its command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from typing import Any

import typer

from pipeline.run_options import build_options, list_settings

EXPERT_STAGES = ("track", "fit")
"""Stages whose options are for researchers: the help shows them in a separate panel."""


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

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        return _append_settings(function, excluded)

    return decorate


def add_settings_of(
    stages: Collection[str], excluded: Collection[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command that takes the options of some stages: those of a door that all commands have in common.

    Args:
        stages: Names of the stages.
        excluded: Names of their settings that do not apply to the command.

    Returns:
        A decorator like `add_settings`.
    """
    others = {name for name, setting in list_settings().items() if not set(setting.stages) & set(stages)}
    return add_settings_except({*others, *excluded})


def _append_settings(function: Callable[..., None], excluded: Collection[str]) -> Callable[..., None]:
    """Replace the `options` parameter of a command by one parameter per setting."""
    own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "options"]
    names = {p.name for p in own}
    extra = _build_parameters(excluded)

    def command(**values: Any) -> None:
        options = build_options({p.name: values[p.name] for p in extra})
        function(**{name: values[name] for name in names}, options=options)

    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + extra
    )
    command.__annotations__ = {p.name: p.annotation for p in [*own, *extra]}
    command.__doc__ = function.__doc__
    return command


def _build_parameters(excluded: Collection[str]) -> list[inspect.Parameter]:
    """Build the parameters of a command from the settings, without the excluded ones, as typer expects them."""
    parameters = []
    for setting in list_settings().values():
        if setting.name in excluded:
            continue
        panel = "For researchers" if setting.stages[0] in EXPERT_STAGES and len(setting.stages) == 1 else None
        option = typer.Option(setting.default, setting.flag, help=setting.help, rich_help_panel=panel)
        kind = inspect.Parameter.KEYWORD_ONLY
        parameters.append(inspect.Parameter(setting.name, kind, default=option, annotation=setting.type))
    return parameters
