"""Words for the numbers of a shot."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from models.core.events import Events
from models.core.fit_result import SAME_STRIKE, SPIN_STATES, ShotNumber, ShotNumbers
from models.core.naming import Naming
from models.core.number_format import (
    format_measured,
    format_probability,
    format_speed,
    format_time,
    format_unit,
    format_with_sigma,
)

# Words by name of a number.
NUMBER_NAMES = {
    "cue_speed": "Speed after the strike",
    "direction": "Direction of the shot",
    "top_spin": "Top or back spin after the strike",
    "top_spin_share": "Top or back spin over rolling spin",
    "tip_height": "Cue tip above or below the centre",
    "side_spin": "Side spin after the strike",
    "side_spin_share": "Side spin over rolling spin",
    "tip_side": "Cue tip beside the centre",
    "contact_speed": "Speed at the first ball",
    "contact_spin_share": "Top or back spin over rolling spin at the first ball",
    "cut_angle": "Cut angle",
    "throw": "Throw",
    "object_speed": "Speed of the object ball",
    "deflection": "Deflection of the cue ball",
    "pocket_offset": "Offset at the pocket",
    "pocket_speed": "Speed at the pocket",
    "length": "Length of the path",
    "cushions": "Cushion contacts",
}
STATE_WORDS = {"draw": "draw", "stun": "stun", "follow": "follow", "roll": "natural roll"}
# Words for positive and negative values.
SIDES = {
    "top_spin": ("top", "back"), "top_spin_share": ("top", "back"), "side_spin": ("right", "left"),
    "side_spin_share": ("right", "left"), "contact_spin_share": ("top", "back"), "cut_angle": ("right", "left"),
    "throw": ("right", "left"), "deflection": ("right", "left"), "pocket_offset": ("right", "left"),
    "tip_height": ("above", "below"), "tip_side": ("right", "left"),
}  # fmt: skip
TIP_NUMBERS = {"top_spin_share": "tip_height", "side_spin_share": "tip_side"}
# Offset of a level cue from the centre over the ball radius, for rolling spin w = v / R: a solid ball that an impulse
# at the offset b sends off at the speed v spins with w = 5 v b / (2 R^2) (Alciatore, technical proof A.30).
TIP_SHARE = 0.4
# Most decimals by unit that a player can use.
DECIMALS = {"m/s": 2, "rad/s": 1, "": 2, "deg": 1, "mm": 1, "m": 2}
# Deviation of an expected number of cushions from a whole one from which both neighbours are possible.
UNSURE_CUSHIONS = 0.1
NOT_OBSERVABLE, NEAR_ZERO = "not measurable", "may be zero"
# Standard deviations from 0 from which the side of a number is known.
SURE_SIGMAS = 2.0
# Words by the least share of the object ball that the cue ball covers at the contact.
FULLNESS_WORDS = (
    (0.875, "full"), (0.625, "three-quarter ball"), (0.375, "half ball"), (0.125, "quarter ball"), (0.0, "thin")
)  # fmt: skip
# Standard deviation of the covered share from which it has no word: half of what a word stands for.
MAX_FULLNESS_SIGMA = 0.125
# Probability that the named states of the cue ball at the first ball must have together.
MIN_STATE_PROBABILITY = 0.95
# States that are named; where more are possible, the spin is not measurable.
MAX_STATES = 2


def format_number(one: ShotNumber, *, has_sigma: bool = True) -> str:
    """Format value, standard deviation, unit and side of a number.

    Args:
        one: The number.
        has_sigma: Whether to write the standard deviation; it decides on the digits in any case.

    Returns:
        Such as `12.3 ± 0.4° right`; `not measurable` where the data do not determine it, `may be zero (1 ± 2°)`
        where its side is not known, because its error reaches zero.
    """
    if not one.observable:
        return NOT_OBSERVABLE
    if one.name.endswith("cushions"):
        return format_cushions(one.value)
    if one.unit == "m/s":
        shown = format_speed(one.value, one.sigma)
        return shown if has_sigma else re.sub(r" ± [\d.]+", "", shown)
    sides, unit = SIDES.get(one.name), format_unit(one.unit)
    value, sigma = format_measured(one.value if sides is None else abs(one.value), one.sigma, DECIMALS[one.unit])
    shown = f"{value}{f' ± {sigma}' if sigma and has_sigma else ''}{' ' * (unit not in '°')}{unit}"
    if sides is None:
        return shown
    if _is_sure(one):
        return f"{shown} {sides[one.value < 0]}"
    return f"{NEAR_ZERO} ({shown})" if has_sigma else NEAR_ZERO


def _is_sure(one: ShotNumber) -> bool:
    """Return whether a number is known to differ from 0."""
    return one.observable and abs(one.value) > SURE_SIGMAS * one.sigma


def format_hit(shot: ShotNumbers) -> str:
    """Format fullness and spin of a hit, such as `half ball, draw, left side`; empty for one of a cluster of balls."""
    cut, side = (shot.find_number(name) for name in ("cut_angle", "side_spin_share"))
    words = []
    if cut is not None:
        fullness = 1 - abs(math.sin(math.radians(cut.value)))
        sigma = math.cos(math.radians(cut.value)) * math.radians(cut.sigma)
        name = next(word for least, word in FULLNESS_WORDS if not fullness < least)
        covered = format_with_sigma(100 * fullness, 100 * sigma, 0)
        angle = format_with_sigma(abs(cut.value), cut.sigma, DECIMALS["deg"])
        is_known = cut.observable and sigma < MAX_FULLNESS_SIGMA
        shown = f"{name} ({covered} % of the ball covered, cut angle {angle}°)"
        words.append(shown if is_known else f"fullness {NOT_OBSERVABLE}")
    if shot.spin_state_probabilities:
        state, p = name_states(shot)
        words.append(state if p else f"spin {state}")
    if side is not None and _is_sure(side):
        words.append(f"{SIDES[side.name][side.value < 0]} side")
    return ", ".join(words)


def format_shot_line(shot: ShotNumbers, naming: Naming, events: Events) -> str:
    """Format the main numbers of a shot in one line without a full stop."""
    strikes = (
        format_time(float(events.t[k]), float(events.t_sigma[k])) for k in range(len(events))
        if (events.kind[k], events.a[k]) == ("strike", shot.cue) and abs(events.t[k] - shot.t) < SAME_STRIKE
    )  # fmt: skip
    parts = [f"{naming.say(shot.cue)} at {next(strikes, f'{format_time(shot.t)}, when it moves already')}"]
    labels = {"cue_speed": "", "top_spin_share": "spin off the cue ", "side_spin_share": "side off the cue "}
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


def list_number_rows(shot: ShotNumbers, naming: Naming, radius: float) -> list[tuple[str, str, str, bool]]:
    """List the numbers of a shot as table rows: words, ball or pocket, value, and whether it is observable.

    Args:
        shot: The numbers.
        naming: What balls, rails and pockets are called.
        radius: m, of the balls.

    Returns:
        The rows, without the ways of the balls; where spin was measured, also where the tip of a level cue hit.
    """
    rows = []
    for one in (number for number in shot.numbers if number.name not in ("length", "cushions")):
        ball = naming.name_ball(one.ball)
        subject = f"{ball}, {naming.name_pocket(one.place)}" if one.place else ball
        heading = name_heading(one.value, naming)
        value = format_direction(one, heading) if one.name == "direction" else format_number(one)
        rows.append((NUMBER_NAMES[one.name], subject, value, one.observable))
        if one.name in TIP_NUMBERS and _is_sure(one):
            size, name = 1e3 * TIP_SHARE * radius, TIP_NUMBERS[one.name]
            tip = replace(one, name=name, value=size * one.value, sigma=size * one.sigma, unit="mm")
            rows.append((NUMBER_NAMES[name], subject, format_number(tip), True))
        if one.name == "contact_spin_share":
            state, p = name_states(shot)
            rows.append(("State at the first ball", ball, f"{state} ({format_probability(p)})" if p else state, p > 0))
    return rows


def name_states(shot: ShotNumbers) -> tuple[str, float]:
    """Name the states of the cue ball at the first ball that are probable enough together, and state how probable."""
    ranked = sorted(zip(shot.spin_state_probabilities, SPIN_STATES, strict=False), reverse=True)
    for count in range(1, MAX_STATES + 1):
        p = sum(chance for chance, _ in ranked[:count])
        if p >= MIN_STATE_PROBABILITY and shot.spin_state != "unknown":
            return " or ".join(STATE_WORDS[state] for _, state in ranked[:count]), p
    return NOT_OBSERVABLE, 0.0


def format_direction(one: ShotNumber, heading: str, *, has_sigma: bool = True) -> str:
    """Format the direction of a shot by its angle to the long rails, and the rails that it leads towards."""
    across, along = (abs(part(math.radians(one.value))) for part in (math.sin, math.cos))
    value, sigma = format_measured(math.degrees(math.atan2(across, along)), one.sigma, DECIMALS["deg"])
    return f"{value}{f' ± {sigma}' if sigma and has_sigma else ''}° {heading}"


def name_heading(degrees: float, naming: Naming) -> str:
    """Name the rails that a direction (degrees from the x axis towards y) leads towards, to follow its angle."""
    along, across = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    rails = naming.say("right" if along > 0 else "left"), naming.say("bottom" if across > 0 else "top")
    return f"to the long {naming.rail_word}s, towards {rails[0]} and {rails[1]}"


def format_cushions(count: float) -> str:
    """Format a number of cushions: a whole one, or two where single contacts are undecided."""
    nearest, lower = round(count), math.floor(count)
    return f"{nearest}" if abs(count - nearest) <= UNSURE_CUSHIONS else f"{lower} or {lower + 1}"
