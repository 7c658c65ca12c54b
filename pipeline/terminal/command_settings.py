"""Adds settings to a command as options of its command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any

import typer

from pipeline.settings import Setting

# Stages whose options are for researchers: the help shows them in a separate panel.
EXPERT_STAGES = ("track", "fit")


def add_settings(
    settings: Mapping[str, Setting], build: Callable[[dict[str, Any]], object], excluded: Collection[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command that takes `options`: its command line has one option per setting instead.

    Args:
        settings: Settings by name.
        build: Makes the options of their values by name.
        excluded: Names of the settings that do not apply to the command.

    Returns:
        The decorator.
    """
    extra = [_build_parameter(setting) for name, setting in settings.items() if name not in excluded]

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        own = [p for p in inspect.signature(function, eval_str=True).parameters.values() if p.name != "options"]

        def command(**values: Any) -> None:
            options = build({p.name: values.pop(p.name) for p in extra})
            function(**values, options=options)

        command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own] + extra
        )
        command.__doc__ = function.__doc__
        return command

    return decorate


def _build_parameter(setting: Setting) -> inspect.Parameter:
    """Build the parameter of a setting as typer expects it."""
    panel = "For researchers" if setting.stages[0] in EXPERT_STAGES and len(setting.stages) == 1 else None
    kind = Annotated[setting.type, typer.Option(help=setting.help, rich_help_panel=panel)]  # type: ignore[name-defined]
    return inspect.Parameter(setting.name, inspect.Parameter.KEYWORD_ONLY, default=setting.default, annotation=kind)
