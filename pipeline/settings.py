"""Settings: the options of stages under the names that the command line and Python give them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar, get_args, get_type_hints

from detectors.detect_options import DetectOptions
from models.core.errors import OptionError
from models.core.options import OptionSpec, list_option_specs
from pipeline.stages.read_stage import ReadOptions
from video.io.video_options import CalibrateOptions, CourtOptions

# A frozen dataclass with the options of one stage in each field.
Options = TypeVar("Options")


@dataclass(frozen=True, slots=True)
class DoorOptions:
    """Options of the stages that decide whether a clip is accepted, and with which table and balls."""

    read: ReadOptions = field(default_factory=ReadOptions)
    calibrate: CalibrateOptions = field(default_factory=CalibrateOptions)
    court: CourtOptions = field(default_factory=CourtOptions)
    detect: DetectOptions = field(default_factory=DetectOptions)


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
    def help(self) -> str:
        """What the option does in every stage, its range and its unit."""
        return " ".join(_format_help(spec) for _, spec in self.specs)


def _format_help(spec: OptionSpec) -> str:
    """Format the help of an option with its range and unit."""
    if spec.valid_range:
        return f"{spec.help} Range: {spec.valid_range}."
    return f"{spec.help} Unit: {spec.unit}." if spec.unit else spec.help


def collect_settings(defaults: object, stages: Collection[str]) -> dict[str, Setting]:
    """Collect the settings of stages.

    Args:
        defaults: Options with a field per stage.
        stages: Names of the stages.

    Returns:
        Settings by name. Options of several stages with the same name are one setting.
    """
    settings: dict[str, Setting] = {}
    for stage in stages:
        options = getattr(defaults, stage)
        types = get_type_hints(type(options))
        for name, spec in list_option_specs(type(options)).items():
            earlier = settings[name].specs if name in settings else ()
            settings[name] = Setting(name, types[name], getattr(options, name), (*earlier, (stage, spec)))
    return settings


def set_value(options: Options, setting: Setting, value: Any) -> Options:
    """Set a typed value in all stages of its setting.

    Args:
        options: Options of all stages.
        value: The value that the user gave.

    Returns:
        The options with the value.

    Raises:
        OptionError: The value is out of range or cannot be used.
    """
    if isinstance(value, int) and float in (setting.type, *get_args(setting.type)):
        value = float(value)  # 8 and 8.0 are one value, with one cache entry
    for _, spec in setting.specs:
        if spec.valid_range and not spec.allows(value):
            raise OptionError(f"{setting.flag} is {spec.valid_range}; got {value}")
    try:
        return replace_setting(options, setting, value)
    except ValueError as error:
        raise OptionError(f"{setting.flag} {value} cannot be used: {error}") from error


def replace_setting(options: Options, setting: Setting, value: Any) -> Options:
    """Replace the value of a setting in all its stages."""
    stages = {stage: replace(getattr(options, stage), **{setting.name: value}) for stage in setting.stages}
    return replace(options, **stages)  # type: ignore[type-var]


def list_door_settings() -> dict[str, Setting]:
    """List the settings of `DoorOptions` without profiles, which are learned from runs and left to these."""
    settings = collect_settings(DoorOptions(), DoorOptions.__slots__)
    return {name: setting for name, setting in settings.items() if name != "profile"}


def build_door_options(values: dict[str, Any]) -> DoorOptions:
    """Build options of the door from the values of its settings by name; raises OptionError as `set_value`."""
    options = DoorOptions()
    for name, value in values.items():
        options = set_value(options, list_door_settings()[name], value)
    return options
