"""Options of tracking and fitting, and how options describe themselves; fast to import.

The command line, its help and its checks are derived from the option dataclasses of all packages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

T = TypeVar("T")
# Key of an `OptionSpec` in the metadata of a dataclass field.
_KEY = "option"


@dataclass(frozen=True, slots=True)
class OptionSpec:
    """Meaning, unit and range of an option."""

    help: str
    """Complete sentences."""
    unit: str = ""
    """Unit of the value, as in "s" or "m/s"; empty where there is none or the help names it."""
    minimum: float | None = None
    """Least value."""
    above: float | None = None
    """Value that must be exceeded, instead of a minimum."""
    maximum: float | None = None
    """Largest value."""

    @property
    def valid_range(self) -> str:
        """The range with its unit in words, such as "more than 0 s"; empty if all values are valid."""
        low = "" if self.above is None else f"more than {self.above:g}"
        if self.minimum is not None:
            low = f"{self.minimum:g}"
        if self.maximum is None:
            words = f"{low} or more" if self.minimum is not None else low
        elif self.minimum is not None:
            words = f"{low} to {self.maximum:g}"
        else:
            words = " and ".join(part for part in (low, f"at most {self.maximum:g}") if part)
        return f"{words} {self.unit}".rstrip() if words else ""

    def allows(self, value: float) -> bool:
        """Whether a value is finite and within the range."""
        return (
            math.isfinite(value)
            and (self.minimum is None or value >= self.minimum)
            and (self.above is None or value > self.above)
            and (self.maximum is None or value <= self.maximum)
        )


def option(
    default: T,
    *,
    help: str,
    unit: str = "",
    minimum: float | None = None,
    above: float | None = None,
    maximum: float | None = None,
) -> T:
    """Declare an option as a field of a frozen dataclass.

    Args:
        help: Meaning, in complete sentences.
        minimum: Least value.
        above: Value that must be exceeded, instead of a minimum.
        maximum: Largest value.

    Returns:
        A dataclass field with this default and an `OptionSpec` in its metadata.
    """
    return field(default=default, metadata={_KEY: OptionSpec(help, unit, minimum, above, maximum)})


def list_option_specs(kind: type[Any]) -> Mapping[str, OptionSpec]:
    """List the options of an option dataclass.

    Args:
        kind: A dataclass whose fields are declared with `option`.

    Returns:
        The specification of each option by the name of its field.
    """
    return {one.name: one.metadata[_KEY] for one in fields(kind)}


@dataclass(frozen=True, slots=True)
class TrackOptions:
    """Options of tracking: how detections become tracks."""

    breadth: int = option(
        8,
        help="Most track hypotheses of an ambiguous moment that are followed side by side; 1 decides at once.",
        unit="hypotheses",
        minimum=1,
    )
    patience: float = option(
        0.4, help="Longest time for which an ambiguous moment may stay undecided.", unit="s", above=0
    )
    balls: int = option(0, help="Most balls on the table; 0 sets no limit.", unit="balls", minimum=0)
    looks: str = option("", help="scene.json (FILE) with corrected names, numbers or colours of the balls.")


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of the fit of a shot."""

    break_price: float = option(
        20.0,
        help="Least decrease of chi2 for which a contact is accepted, where a ball or cushion is near enough.",
        minimum=0,
    )
    free_price: float = option(
        150.0,
        help="Least decrease of chi2 for which a velocity change is accepted, where no ball or cushion is near.",
        minimum=0,
    )
    laws: bool = option(
        False,
        help="Fit whole shots of up to four moving balls with published contact models, which gives spin, cushion"
        " friction and ball size; it takes up to a minute. Without it, trueroll what-if does so when it needs them.",
    )
    profile: str = option(
        "", help="Of trueroll fit-table, diagnose or run: contact models and parameters of the fit of whole shots."
    )
    moving_speed: float = option(
        0.02, help="Speed above which a ball counts as moving.", unit="m/s", above=0, maximum=1
    )


# chi2: least gain of a contact that the whole clip needs, the usual price of a contact.
REQUIRED_GAIN = FitOptions().break_price
