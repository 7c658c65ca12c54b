"""Options of a stroke that is played otherwise, as a person types them or a page sends them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from models.core.errors import OptionError
from models.estimation.changed_shot import PlayerSpread, StrokeChange
from pipeline.actions.play_otherwise import estimate_session_spread

# m/s: no stroke is faster; breaks reach 12.
MAX_SPEED = 15.0
# R omega / v: a tip that is off the centre by more than R/2 slips, and gives 5/4 there.
MAX_SPIN = 1.5
_AMOUNT = re.compile(r"(?P<number>[+-]?(\d+(\.\d*)?|\.\d+))(?P<unit>%|deg|m/s)?")


def choose_spread(spread: str | None, session: Sequence[str | PathLike[str]] | None = None) -> tuple[PlayerSpread, str]:
    """Choose the spread of the player.

    Args:
        spread: Share of the speed and degrees, such as `3%,0.4`; None where it is not given.
        session: Run folders that repeat one shot; None where they are not given.

    Returns:
        The spread, and where it comes from: `user`, `session` or `none`.

    Raises:
        OptionError: It is malformed, both are given, or the session has no repetitions.
    """
    if spread is not None and session:
        raise OptionError("--spread and --session both state the player's spread; give one of them")
    if session:
        return estimate_session_spread([Path(one) for one in session]), "session"
    if spread is None:
        return PlayerSpread(), "none"
    parts = re.fullmatch(r"(\d+(?:\.\d*)?)%,(\d+(?:\.\d*)?)(?:deg)?", spread.replace(" ", ""))
    if parts is None or float(parts[1]) > 50 or float(parts[2]) > 20:
        raise OptionError(f"is a share of the speed and degrees, such as 3%,0.4; got {spread}", option="spread")
    return PlayerSpread(float(parts[1]) / 100, float(parts[2])), "user"


# A number, or its text with a sign and a unit.
Amount = str | float | None


def parse_change(speed: Amount = None, angle: Amount = None, side: Amount = None, top: Amount = None) -> StrokeChange:
    """Parse how a stroke differs from the real one.

    Args:
        speed: Change in %, such as `-5%`, or the speed in m/s.
        angle: Turn in degrees to the right of the player.
        side: Points of side spin to add, such as `+10%`, or the whole.
        top: Points of top spin to add, such as `-20%`, or the whole.

    Returns:
        The change.

    Raises:
        OptionError: An amount is malformed or out of range.
    """
    values: dict[str, float] = {}
    if speed is not None:
        number, unit = _parse_amount("speed", speed, ("%", "m/s", ""))
        if unit != "%" and str(speed).strip()[0] in "+-":
            raise OptionError(
                f"is a change with %, or a speed in m/s without sign; got {speed}: write {number:+g}% to change"
                f" it by {abs(number):g} %, or {abs(number):g} to play at {abs(number):g} m/s", option="speed",
            )  # fmt: skip
        values |= {"speed_factor": 1 + number / 100} if unit == "%" else {"speed": number}
        if not 0 < values.get("speed_factor", 1.0) <= 3 or not 0 < values.get("speed", 1.0) <= MAX_SPEED:
            raise OptionError(f"is a change of -99% to +200%, or up to {MAX_SPEED:g} m/s; got {speed}", option="speed")
    if angle is not None:
        number, _ = _parse_amount("angle", angle, ("deg", ""))
        if abs(number) > 180:
            raise OptionError(f"is a turn of at most 180 degrees; got {angle}", option="angle")
        values["angle"] = number
    for name, text in (("side", side), ("top", top)):
        if text is not None:
            number, unit = _parse_amount(name, text, ("%", ""))
            share = number / 100 if unit == "%" else number
            if abs(share) > MAX_SPIN:
                raise OptionError(f"is at most {MAX_SPIN:g}, or {MAX_SPIN:.0%}; got {text}", option=name)
            values[f"{name}_added" if unit == "%" else name] = share
    return StrokeChange(**values)


def _parse_amount(option: str, text: str | float, units: tuple[str, ...]) -> tuple[float, str]:
    """Return number and unit; the unit is empty where none was given."""
    parts = _AMOUNT.fullmatch(str(text).strip())
    if parts is None or (parts["unit"] or "") not in units:
        unit = f" with {' or '.join(filter(None, units))}" if any(units) else ""
        raise OptionError(f"is a number{unit}; got {text}", option=option)
    return float(parts["number"]), parts["unit"] or ""
