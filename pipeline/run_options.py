"""Options of a run: the option dataclasses of all stages, and the settings of the command line derived from them."""

from __future__ import annotations

import inspect
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

import typer

from detectors.detect_options import DetectOptions
from models.core.by_hand.corrections import NO_CORRECTIONS, Corrections
from models.core.errors import OptionError
from models.core.options import FitOptions, ForecastOptions, OptionSpec, TrackOptions, list_option_specs
from pipeline.stages.read_stage import ReadOptions
from video.io.video_options import CalibrateOptions, RenderOptions

OPTION_STAGES = ("read", "calibrate", "detect", "track", "fit", "render", "forecast")
"""Stages with options, in the order of the help."""
EXPERT_STAGES = ("track", "fit", "forecast")
"""Stages whose options are for researchers: the help shows them in a separate panel."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The options of all stages."""

    read: ReadOptions = field(default_factory=ReadOptions)
    calibrate: CalibrateOptions = field(default_factory=CalibrateOptions)
    detect: DetectOptions = field(default_factory=DetectOptions)
    track: TrackOptions = field(default_factory=TrackOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    render: RenderOptions = field(default_factory=RenderOptions)
    forecast: ForecastOptions = field(default_factory=ForecastOptions)
    corrections: Corrections = NO_CORRECTIONS
    """What a person corrected in this clip; not an option of the command line."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One option of the command line, and the options of stages that it sets."""

    name: str
    type: Any
    default: Any
    specs: tuple[tuple[str, OptionSpec], ...]
    """(stage, specification) of every stage with an option of this name."""

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages with an option of this name."""
        return tuple(stage for stage, _ in self.specs)

    @property
    def flag(self) -> str:
        """The option as typed, such as `--ball-radius`."""
        return "--" + self.name.replace("_", "-")

    @property
    def off_flag(self) -> str:
        """The opposite option, such as `--no-laws`, of a setting that is neither on nor off by default; else empty."""
        return f"--no-{self.flag.removeprefix('--')}" if self.type == bool | None else ""

    @property
    def help(self) -> str:
        """What the option does in every stage, its range and its unit."""
        return " ".join(_format_help(spec) for _, spec in self.specs)


def _format_help(spec: OptionSpec) -> str:
    """Format the help of an option with its range and unit."""
    if spec.valid_range:
        return f"{spec.help} Range: {spec.valid_range}."
    return f"{spec.help} Unit: {spec.unit}." if spec.unit else spec.help


@cache
def list_settings() -> dict[str, Setting]:
    """List the settings of the command line.

    Returns:
        Settings by name. Options of several stages with the same name are one setting.
    """
    settings: dict[str, Setting] = {}
    defaults = RunOptions()
    for stage in OPTION_STAGES:
        options = getattr(defaults, stage)
        types = get_type_hints(type(options))
        for name, spec in list_option_specs(type(options)).items():
            earlier = settings[name].specs if name in settings else ()
            settings[name] = Setting(name, types[name], getattr(options, name), (*earlier, (stage, spec)))
    return settings


def build_parameters(excluded: Collection[str] = ()) -> list[inspect.Parameter]:
    """Build the parameters of a command from the settings, as typer expects them.

    Args:
        excluded: Names of settings to leave out.

    Returns:
        Keyword parameters.
    """
    parameters = []
    for setting in list_settings().values():
        if setting.name in excluded:
            continue
        panel = "For researchers" if setting.stages[0] in EXPERT_STAGES and len(setting.stages) == 1 else None
        flags = f"{setting.flag}/{setting.off_flag}" if setting.off_flag else setting.flag
        option = typer.Option(setting.default, flags, help=setting.help, rich_help_panel=panel)
        kind = inspect.Parameter.KEYWORD_ONLY
        parameters.append(inspect.Parameter(setting.name, kind, default=option, annotation=setting.type))
    return parameters


def build_options(values: dict[str, Any]) -> RunOptions:
    """Build the options of all stages from the values of settings.

    Args:
        values: Values by the name of the setting; settings that are left out have their defaults.

    Returns:
        The options.

    Raises:
        OptionError: A value is out of range or cannot be used.
    """
    options = RunOptions()
    for name, setting in list_settings().items():
        if name not in values:
            continue
        value = _read_file_content(name, values[name])
        _require_in_range(setting, value)
        for stage in setting.stages:
            try:
                changed = replace(getattr(options, stage), **{name: value})
            except ValueError as error:
                raise OptionError(f"{setting.flag} {value} cannot be used: {error}") from error
            options = replace(options, **{stage: changed})
    return options


def apply_corrections(options: RunOptions, corrections: Corrections) -> RunOptions:
    """Apply the corrections of a clip: the command line beats them, and they beat the defaults.

    Args:
        options: Options of the command line.
        corrections: What a person corrected.

    Returns:
        The options with the corrections.

    Raises:
        OptionError: A correction cannot be used.
    """
    corners = corrections.corners
    values = {
        "corners": None if corners is None else ",".join(f"{value:g}" for corner in corners for value in corner),
        "table": corrections.table,
        "ball_radius": corrections.ball_radius,
        "fps": corrections.fps,
    }
    for name, setting in list_settings().items():
        if values.get(name) is None or any(
            getattr(getattr(options, stage), name) != setting.default for stage in setting.stages
        ):
            continue
        for stage in setting.stages:
            try:
                changed = replace(getattr(options, stage), **{name: values[name]})
            except ValueError as error:
                raise OptionError(f"The corrections of the clip set {name} to {values[name]}: {error}") from error
            options = replace(options, **{stage: changed})
    return replace(options, corrections=corrections)


def use_growing_profile(options: RunOptions, path: Path) -> RunOptions:
    """Use a table profile that the run will improve; a missing file holds nothing yet.

    Args:
        options: Options of all stages.
        path: File of the profile.

    Returns:
        The options with its content.

    Raises:
        OptionError: The file cannot be used, or another profile is in use.
    """
    if options.fit.profile:
        raise OptionError("--update-profile reads its file too: leave --profile out")
    if not path.exists():
        return options
    content = _read_file_content("profile", str(path))
    stages = list_settings()["profile"].stages
    return replace(options, **{stage: replace(getattr(options, stage), profile=content) for stage in stages})


def _read_file_content(name: str, value: Any) -> Any:
    """Read the file of a setting whose value is the content of a file."""
    if name != "profile" or not value or value.startswith("{"):
        return value
    from pipeline.io.table_profile import read_profile_text  # pydantic is slow to import

    return read_profile_text(Path(value))


def _require_in_range(setting: Setting, value: Any) -> None:
    """Raise OptionError for a number outside the range of the setting, before any work starts."""
    for _, spec in setting.specs:
        if spec.valid_range and not spec.allows(value):
            raise OptionError(f"{setting.flag} is {spec.valid_range}; got {value}")


def format_changed_settings(options: RunOptions) -> tuple[str, ...]:
    """Format the settings that differ from their defaults as they are typed.

    Args:
        options: Options of all stages.

    Returns:
        Flags with their values.
    """
    words = []
    for name, setting in list_settings().items():
        value = getattr(getattr(options, setting.stages[0]), name)
        if value != setting.default:
            is_flag = value is True or name == "profile"  # the value of profile is the content of its file
            off = setting.off_flag if value is False else ""
            words.append(off or (setting.flag if is_flag else f"{setting.flag} {value}"))
    return tuple(words)
