"""Adds settings to a command as options of its command line; those of the door are common to all commands."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable
from typing import Annotated, Any

import typer

from pipeline.settings import DoorOptions, Setting, collect_settings, set_value

# Stages whose options are for researchers: the help shows them in a separate panel.
EXPERT_STAGES = ("track", "fit")


def add_door_settings(excluded: Collection[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command that takes `DoorOptions` as its `options` argument.

    Profiles, which are learned from runs, are left to `run`.

    Args:
        excluded: Names of the settings that do not apply to the command.

    Returns:
        A decorator, which adds one option per setting to the command line.
    """
    settings = collect_settings(DoorOptions(), DoorOptions.__slots__)
    settings = {name: setting for name, setting in settings.items() if name not in ("profile", *excluded)}

    def build(values: dict[str, Any]) -> DoorOptions:
        options = DoorOptions()
        for name, value in values.items():
            options = set_value(options, settings[name], value)
        return options

    return lambda function: append_settings(function, settings.values(), build)


def append_settings(
    function: Callable[..., None], settings: Iterable[Setting], build: Callable[[dict[str, Any]], object]
) -> Callable[..., None]:
    """Replace the `options` parameter of a command by one parameter per setting.

    Args:
        function: The command.
        build: Makes the options of their values by name.

    Returns:
        The command with one option per setting on the command line.
    """
    own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "options"]
    names = {p.name for p in own}
    extra = [_build_parameter(setting) for setting in settings]

    def command(**values: Any) -> None:
        options = build({p.name: values[p.name] for p in extra})
        function(**{name: values[name] for name in names}, options=options)

    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + extra
    )
    command.__doc__ = function.__doc__
    return command


def _build_parameter(setting: Setting) -> inspect.Parameter:
    """Build the parameter of a setting as typer expects it."""
    panel = "For researchers" if setting.stages[0] in EXPERT_STAGES and len(setting.stages) == 1 else None
    kind = Annotated[setting.type, typer.Option(help=setting.help, rich_help_panel=panel)]  # type: ignore[name-defined]
    return inspect.Parameter(setting.name, inspect.Parameter.KEYWORD_ONLY, default=setting.default, annotation=kind)
