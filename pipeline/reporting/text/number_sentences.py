"""Words for the numbers of a shot."""

from __future__ import annotations

import math

from models.core.naming import Naming
from models.core.number_format import format_probability, format_speed, format_with_sigma
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
    "draw": "draw", "stun": "stun", "follow": "follow", "roll": "natural roll", "unknown": "not measurable",
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
NOT_OBSERVABLE = "not measurable"
SURE_SIGMAS = 2.0
"""Standard deviations from 0 from which the side of a number is known."""
FULLNESS_WORDS = (
    (0.875, "full"), (0.625, "three-quarter ball"), (0.375, "half ball"), (0.125, "quarter ball"), (0.0, "thin")
)  # fmt: skip
"""Words by the least share of the object ball that the cue ball covers at the contact, 1 - sin(cut angle)."""
MAX_CUT_SIGMA = 3.0
"""Degrees, standard deviation of a cut angle from which its fullness has no word."""
MIN_STATE_PROBABILITY = 0.95
"""Probability from which the spin of the cue ball at the first ball has a word."""


def format_number(one: ShotNumber) -> str:
    """Format value, standard deviation, unit and side of a number.

    Args:
        one: The number.

    Returns:
        Such as `12.3 ± 0.4° right`; `not measurable` where the data do not determine it, `either way` for its side.
    """
    if not one.observable:
        return NOT_OBSERVABLE
    if one.name == "cushions":
        return format_cushions(one.value, one.sigma)
    if one.unit == "m/s":
        return format_speed(one.value, one.sigma)
    sides = SIDES.get(one.name)
    value = one.value if sides is None else abs(one.value)
    unit = {"deg": "°", "": ""}.get(one.unit, f" {one.unit}")
    shown = format_with_sigma(value, one.sigma, DECIMALS[one.unit])
    if sides is None or shown.startswith("0 "):
        return f"{shown}{unit}"
    return f"{shown}{unit} {sides[one.value < 0] if _is_sure(one) else 'either way'}"


def _is_sure(one: ShotNumber) -> bool:
    """Return whether a number is known to differ from 0."""
    return one.observable and abs(one.value) > SURE_SIGMAS * one.sigma


def format_hit(shot: ShotNumbers) -> str:
    """Format what the data determine of a hit, such as `half ball, draw, left side`; empty where it is nothing."""
    cut, side = (shot.find_number(name) for name in ("cut_angle", "side_spin_share"))
    words = []
    if cut is not None and cut.observable and cut.sigma < MAX_CUT_SIGMA:
        fullness = 1 - abs(math.sin(math.radians(cut.value)))
        words.append(next(word for least, word in FULLNESS_WORDS if fullness >= least))
    if max(shot.spin_state_probabilities, default=0.0) >= MIN_STATE_PROBABILITY and shot.spin_state != "unknown":
        words.append(STATE_WORDS[shot.spin_state])
    if side is not None and _is_sure(side):
        words.append(f"{SIDES[side.name][side.value < 0]} side")
    return ", ".join(words)


def format_shot_line(shot: ShotNumbers, naming: Naming) -> str:
    """Format the main numbers of a shot in one line without a full stop."""
    parts = [f"{naming.say(shot.cue)} at {shot.t:.2f} s"]
    labels = {"cue_speed": "", "top_spin_share": "spin ", "side_spin_share": "side ", "cut_angle": "cut "}
    parts += [
        label + format_number(one)
        for name, label in labels.items()
        if (one := shot.find_number(name)) is not None and _is_sure(one)
    ]
    if shot.first:
        hit = format_hit(shot)
        parts.append(f"{naming.say(shot.first)} first{hit and f' ({hit})'}")
    for ball, pocket in zip(shot.potted, shot.pockets, strict=True):
        parts.append(f"{naming.say(ball)} into the {naming.name_pocket(pocket)}")
    return ", ".join(parts)


def list_number_rows(shot: ShotNumbers, naming: Naming) -> list[tuple[str, str, str, bool]]:
    """List the numbers of a shot as table rows: words, ball or pocket, value, and whether it is observable."""
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
