"""Words for the numbers of a shot."""

from __future__ import annotations

from models.core.naming import Naming
from models.core.number_format import format_probability, format_with_sigma
from models.core.shot_numbers import ShotNumber, ShotNumbers

NUMBER_NAMES = {
    "cue_speed": "Speed after the strike",
    "direction": "Direction from the x axis",
    "top_spin": "Top spin after the strike",
    "top_spin_share": "Top spin over rolling spin",
    "side_spin": "Side spin after the strike",
    "side_spin_share": "Side spin, R ω / v",
    "contact_speed": "Speed at the first ball",
    "contact_spin_share": "Top spin over rolling spin at the first ball",
    "cut_angle": "Cut angle",
    "throw": "Throw",
    "object_speed": "Speed of the object ball",
    "deflection": "Deflection of the cue ball",
    "pocket_offset": "Offset at the pocket",
    "pocket_speed": "Speed at the pocket",
    "length": "Length of the path",
    "cushions": "Cushions",
}
"""Words by name of a number."""
STATE_WORDS = {
    "draw": "draw", "stun": "stun", "follow": "follow", "roll": "natural roll", "unknown": "not observable",
}  # fmt: skip
SIDES = {
    "top_spin": ("top", "back"), "top_spin_share": ("top", "back"), "side_spin": ("right", "left"),
    "side_spin_share": ("right", "left"), "contact_spin_share": ("top", "back"), "cut_angle": ("right", "left"),
    "throw": ("right", "left"), "deflection": ("right", "left"), "pocket_offset": ("right", "left"),
}  # fmt: skip
"""Words for positive and negative values."""
DECIMALS = {"m/s": 2, "rad/s": 1, "": 2, "deg": 1, "mm": 1, "m": 2}
"""Most decimals by unit that a player can use."""
UNSURE_CUSHIONS = 0.1
"""Deviation from a whole number, and standard deviation, of a number of cushions from which it has a decimal."""
NOT_OBSERVABLE = "not observable"


def format_number(one: ShotNumber) -> str:
    """Format value, standard deviation, unit and side of a number.

    Args:
        one: The number.

    Returns:
        Such as `12.3 ± 0.4° right`; `not observable` where the data do not determine it.
    """
    if not one.observable:
        return NOT_OBSERVABLE
    if one.name == "cushions":
        return format_cushions(one.value, one.sigma)
    sides = SIDES.get(one.name)
    value = one.value if sides is None else abs(one.value)
    unit = {"deg": "°", "": ""}.get(one.unit, f" {one.unit}")
    shown = format_with_sigma(value, one.sigma, DECIMALS[one.unit])
    side = "" if sides is None or shown.startswith("0 ") else f" {sides[one.value < 0]}"
    return f"{shown}{unit}{side}"


def format_shot_line(shot: ShotNumbers, naming: Naming) -> str:
    """Format the main numbers of a shot in one line.

    Args:
        shot: Numbers of the shot.
        naming: What balls and pockets are called.

    Returns:
        One line without a full stop.
    """
    parts = [f"{naming.name_ball(shot.cue)} at {shot.t:.2f} s"]
    for name, label in (("cue_speed", ""), ("top_spin_share", "spin "), ("side_spin_share", "side ")):
        one = shot.find_number(name)
        if one is not None and one.observable:
            parts.append(label + format_number(one))
    if shot.first:
        first = naming.say(shot.first)
        parts.append(f"{STATE_WORDS[shot.spin_state]} at {first}" if shot.spin_state != "unknown" else first)
        for name, label in (("cut_angle", "cut "), ("throw", "throw ")):
            one = shot.find_number(name)
            if one is not None and one.observable:
                parts.append(label + format_number(one))
    for ball, pocket in zip(shot.potted, shot.pockets, strict=True):
        parts.append(f"{naming.say(ball)} into the {naming.name_pocket(pocket)}")
    return ", ".join(parts)


def list_number_rows(shot: ShotNumbers, naming: Naming) -> list[tuple[str, str, str, bool]]:
    """List the numbers of a shot as table rows.

    Args:
        shot: Numbers of the shot.
        naming: What balls and pockets are called.

    Returns:
        Words, ball or pocket, value, and whether it is observable.
    """
    rows = []
    for one in shot.numbers:
        ball = naming.name_ball(one.ball)
        subject = f"{ball}, {naming.name_pocket(one.place)}" if one.place else ball
        rows.append((NUMBER_NAMES[one.name], subject, format_number(one), one.observable))
        if one.name == "contact_spin_share":
            rows.append(("State at the first ball", ball, _format_state(shot), shot.spin_state != "unknown"))
    return rows


def _format_state(shot: ShotNumbers) -> str:
    if shot.spin_state == "unknown" or not shot.spin_state_probabilities:
        return NOT_OBSERVABLE
    return f"{STATE_WORDS[shot.spin_state]} ({format_probability(max(shot.spin_state_probabilities))})"


def format_cushions(count: float, sigma: float = 0.0) -> str:
    """Format a number of cushions: a whole one, unless single contacts are undecided."""
    return f"{count:.1f}" if sigma > UNSURE_CUSHIONS or abs(count - round(count)) > UNSURE_CUSHIONS else f"{count:.0f}"
