"""Options of the command line, made from the option dataclasses of the stages."""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

import typer

from detectors.options import DetectOptions
from models.core.errors import OptionError
from models.core.options import FitOptions, ForecastOptions, TrackOptions
from pipeline.stages.read_stage import ReadOptions
from video.io.options import CalibrateOptions, RenderOptions

SMALLEST = math.ulp(0.0)
"""The least number above 0."""

PARTS = ("read", "calibrate", "detect", "track", "fit", "render", "forecast")
EXPERT_PARTS = ("track", "fit", "forecast")
"""Their options are for researchers: shown in a panel of their own."""


RANGES: Mapping[str, tuple[float, float, str]] = {
    "breadth": (1, math.inf, "1 or more readings"),
    "patience": (SMALLEST, math.inf, "more than 0 s"),
    "balls": (0, math.inf, "0 (as many as are seen) or more"),
    "break_price": (0, math.inf, "0 or more"),
    "free_price": (0, math.inf, "0 or more"),
    "moving_speed": (SMALLEST, 1, "more than 0 and at most 1 m/s"),
    "slow": (1, 100, "1 to 100 times"),
}
"""By setting: least, most, and both in words; all are finite."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options of every stage that has any."""

    read: ReadOptions = field(default_factory=ReadOptions)
    calibrate: CalibrateOptions = field(default_factory=CalibrateOptions)
    detect: DetectOptions = field(default_factory=DetectOptions)
    track: TrackOptions = field(default_factory=TrackOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    render: RenderOptions = field(default_factory=RenderOptions)
    forecast: ForecastOptions = field(default_factory=ForecastOptions)


@dataclass(frozen=True, slots=True)
class Setting:
    """One option on the command line, with the stages that it reaches."""

    name: str
    parts: tuple[str, ...]
    kind: Any
    default: Any
    help: str

    @property
    def flag(self) -> str:
        return "--" + self.name.replace("_", "-")


@cache
def run_settings() -> dict[str, Setting]:
    """Every field of every stage's options by name; a name that several stages share is one setting."""
    settings: dict[str, Setting] = {}
    for part in PARTS:
        options = getattr(RunOptions(), part)
        kind = type(options)
        hints, words = get_type_hints(kind), field_docstrings(kind)
        for option in fields(kind):
            name = option.name
            before = settings.get(name)
            parts = (*before.parts, part) if before else (part,)
            sentence = f"{before.help} {words[name]}" if before else words[name]
            settings[name] = Setting(name, parts, hints[name], getattr(options, name), sentence)
    return settings


def field_docstrings(kind: type) -> dict[str, str]:
    """The string under each field of a dataclass: what it means and its unit."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    words: dict[str, str] = {}
    for node, after in zip(body.body, body.body[1:], strict=False):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            words[node.target.id] = " ".join(str(after.value.value).split()) if told else ""  # type: ignore[attr-defined]
    return {option.name: _sentence(words.get(option.name, "")) for option in fields(kind)}


def _sentence(words: str) -> str:
    """The words with a capital, but for names such as chi2 that are never written so, and a full stop."""
    start = words if words.startswith("chi2") else words[:1].upper() + words[1:]
    return start if start.endswith((".", "!", "?")) or not start else start + "."


def parameters(without: Collection[str] = ()) -> list[inspect.Parameter]:
    """The settings as keyword parameters that typer understands, but for those of some names."""
    made = []
    for setting in run_settings().values():
        if setting.name in without:
            continue
        panel = "For researchers" if setting.parts[0] in EXPERT_PARTS and len(setting.parts) == 1 else None
        option = typer.Option(setting.default, setting.flag, help=setting.help, rich_help_panel=panel)
        kind = inspect.Parameter.KEYWORD_ONLY
        made.append(inspect.Parameter(setting.name, kind, default=option, annotation=setting.kind))
    return made


def collect(values: dict[str, Any]) -> RunOptions:
    """Options of all stages from values by setting name; what is left out has its default."""
    options = RunOptions()
    for name, setting in run_settings().items():
        if name not in values:
            continue
        value = _read(name, values[name])
        _check_range(setting, value)
        for part in setting.parts:
            try:
                changed = replace(getattr(options, part), **{name: value})
            except ValueError as error:
                raise OptionError(f"{setting.flag} {value} cannot be used: {error}") from error
            options = replace(options, **{part: changed})
    return options


def _read(name: str, value: Any) -> Any:
    """The content of a file where a setting names one and its content is what counts."""
    if name != "profile" or not value or value.startswith("{"):
        return value
    from pipeline.io.table_profile import profile_text  # pydantic is slow to import

    return profile_text(Path(value))


def _check_range(setting: Setting, value: Any) -> None:
    """OptionError where a number is outside of what makes sense, before any work starts."""
    if setting.name in RANGES:
        least, most, words = RANGES[setting.name]
        if not (least <= value <= most and math.isfinite(value)):
            raise OptionError(f"{setting.flag} is {words}; got {value}")


def told_apart(options: RunOptions) -> tuple[str, ...]:
    """The settings that differ from their defaults, as one would type them."""
    words = []
    for name, setting in run_settings().items():
        value = getattr(getattr(options, setting.parts[0]), name)
        if value != setting.default:
            alone = value is True or name == "profile"  # which holds the content of its file
            words.append(setting.flag if alone else f"{setting.flag} {value}")
    return tuple(words)
