"""Options of a run: the option dataclasses of all stages, and the settings of the command line derived from them."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypedDict

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.errors import OptionError
from models.core.options import FitOptions, TrackOptions
from pipeline.settings import DoorOptions, Setting, collect_settings, replace_setting, set_value
from video.io.video_options import RenderOptions

# Stages with options, in the order of the help.
OPTION_STAGES = ("read", "calibrate", "court", "detect", "track", "fit", "render")
# Settings that a person can correct; fields of `Corrections` have the same names.
CORRECTED_SETTINGS = ("corners", "sport", "table", "ball_radius", "fps")
# Settings whose value is the content of a file.
FILE_SETTINGS = ("profile", "looks")


@dataclass(frozen=True, slots=True)
class RunOptions(DoorOptions):
    """The options of all stages."""

    track: TrackOptions = field(default_factory=TrackOptions)
    fit: FitOptions = field(default_factory=FitOptions)
    render: RenderOptions = field(default_factory=RenderOptions)
    corrections: Corrections = NO_CORRECTIONS
    """What a person corrected in this clip; not an option of the command line."""


class RunSettings(TypedDict, total=False):
    """The settings of a run as keyword arguments of Python; a test compares them with the options of all stages."""

    fps: str | None
    pixel_aspect: str | None
    corners: str | None
    table: str | None
    ball_radius: float | None
    profile: str
    sport: str | None
    looks: str
    detector: Literal["auto", "hough", "onnx"]
    model: str | None
    breadth: int
    patience: float
    balls: int
    break_price: float
    free_price: float
    laws: bool
    moving_speed: float
    slow: float
    quick: bool
    no_video: bool
    trim_still: bool
    style: Literal["clean", "coach", "umpire"]


@cache
def list_settings() -> dict[str, Setting]:
    """List the settings of the command line.

    Returns:
        Settings by name. Options of several stages with the same name are one setting.
    """
    return collect_settings(RunOptions(), OPTION_STAGES)


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
        options = set_value(options, setting, value)
    return options


def list_setting_values(options: RunOptions) -> dict[str, Any]:
    """List the values of all settings as JSON values.

    Args:
        options: Options of all stages.

    Returns:
        Values by the name of the setting.
    """
    return {name: getattr(getattr(options, one.stages[0]), name) for name, one in list_settings().items()}


def list_changed_values(options: RunOptions) -> dict[str, Any]:
    """List the values of the settings that differ from their defaults.

    Args:
        options: Options of all stages.

    Returns:
        JSON values by the name of the setting.
    """
    settings = list_settings()
    return {name: value for name, value in list_setting_values(options).items() if value != settings[name].default}


def apply_corrections(options: RunOptions, corrections: Corrections) -> RunOptions:
    """Apply the corrections of a clip: the command line beats them, and they beat the defaults.

    Args:
        options: Options of the command line.
        corrections: What a person corrected.

    Returns:
        The options with the corrections that count.

    Raises:
        OptionError: A correction cannot be used.
    """
    typed = list_changed_values(options)
    for name, value in _list_corrected_values(corrections).items():
        if name in typed:
            unset: dict[str, Any] = {name: None}
            corrections = replace(corrections, **unset)
        elif value is not None:
            try:
                options = _apply_setting(options, name, value)
            except (ValueError, OptionError) as error:
                words, remedy = str(error), ""
                if isinstance(error, OptionError):  # what else can be done, each front end says in its own words
                    words, remedy = error.word(str, {}), error.remedy
                sentence = f"The corrections of the clip set {name} to {value}: {words}"
                raise OptionError(sentence, remedy=remedy) from error
    return replace(options, corrections=corrections)


def require_possible_settings(corrections: Corrections) -> None:
    """Require that the settings of new corrections can be used; raises OptionError."""
    for name, value in _list_corrected_values(corrections).items():
        if value is not None:
            try:
                _apply_setting(RunOptions(), name, value)
            except ValueError as error:
                raise OptionError(f"cannot be {value}: {error}", option=name.replace("_", "-")) from error


def _apply_setting(options: RunOptions, name: str, value: Any) -> RunOptions:
    """Set a setting; a table or a ball must exist, as for the calibration. Raises OptionError or ValueError."""
    from models.physics.billiards.tables import parse_table  # slow to import

    options = replace_setting(options, list_settings()[name], value)
    if name == "table":
        parse_table(value)
    elif name == "ball_radius":
        parse_table("pool-9ft", value)  # balls of any table have these bounds
    return options


def list_overridden_flags(options: RunOptions, corrections: Corrections) -> tuple[str, ...]:
    """List the options of the command line that differ from corrections of the same setting.

    Args:
        options: Options of the command line.
        corrections: What a person corrected.

    Returns:
        Flags such as `--corners`.
    """
    typed = _list_typed_corrections(options)
    names = (name for name, value in typed.items() if getattr(corrections, name) not in (None, value))
    return tuple(list_settings()[name].flag for name in names)


def reset_settings(options: RunOptions, names: Collection[str] = CORRECTED_SETTINGS) -> RunOptions:
    """Set settings to their defaults.

    Args:
        options: Options of all stages.
        names: Names of the settings; by default those that a person can correct.

    Returns:
        The other options.
    """
    for setting in (list_settings()[name] for name in names):
        options = replace_setting(options, setting, setting.default)
    return options


def start_corrections(options: RunOptions, corrections: Corrections) -> Corrections:
    """Add the options that a person can correct to the corrections, where these do not set them.

    Args:
        options: Options with which a run or an editor started.
        corrections: What a person corrected.

    Returns:
        The corrections to start from.
    """
    typed = _list_typed_corrections(options)
    return replace(corrections, **{name: typed[name] for name in typed if getattr(corrections, name) is None})


def _list_typed_corrections(options: RunOptions) -> dict[str, Any]:
    """List the options that a person can correct as fields of `Corrections`; malformed corners are left to the run."""
    typed = list_changed_values(options)
    values = {name: typed[name] for name in CORRECTED_SETTINGS if name in typed}
    if "corners" in values:
        text = values.pop("corners")
        with suppress(ValueError):
            numbers = [float(number) for number in text.replace(";", ",").replace(" ", ",").split(",") if number]
            corners = tuple(zip(numbers[::2], numbers[1::2], strict=True))
            values["corners"] = Corrections(corners=corners).corners
    return values


def _list_corrected_values(corrections: Corrections) -> dict[str, Any]:
    """List the values of `CORRECTED_SETTINGS` as settings; None where they were not corrected."""
    corners = corrections.corners
    text = None if corners is None else ",".join(f"{value:g}" for corner in corners for value in corner)
    return {name: text if name == "corners" else getattr(corrections, name) for name in CORRECTED_SETTINGS}


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
    return replace_setting(options, list_settings()["profile"], _read_file_content("profile", str(path)))


def _read_file_content(name: str, value: Any) -> Any:
    """Read the file of a setting whose value is the content of a file."""
    if name not in FILE_SETTINGS or not value or value.startswith("{"):
        return value
    if name == "looks":
        from pipeline.io.run_folder import read_looks_text  # imports pyarrow

        return read_looks_text(Path(value))
    from pipeline.io.table_profile import read_profile_text  # pydantic is slow to import

    return read_profile_text(Path(value))


def format_changed_settings(options: RunOptions) -> tuple[str, ...]:
    """Format the settings that differ from their defaults as they are typed.

    Args:
        options: Options of all stages.

    Returns:
        Flags with their values.
    """
    flags = {name: setting.flag for name, setting in list_settings().items()}
    return tuple(
        flags[name] if value is True or name in FILE_SETTINGS else f"{flags[name]} {value}"
        for name, value in list_changed_values(options).items()
    )
