"""Words for the numbers of a shot, of a session of shots, and of a shot that is played otherwise."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from models.core.events import Events
from models.core.fit_result import SAME_STRIKE, SPIN_STATES, ShotNumber, ShotNumbers
from models.core.naming import Naming
from models.core.number_format import (
    format_doubt,
    format_measured,
    format_moment,
    format_probability,
    format_speed,
    format_time,
    format_unit,
    format_with_sigma,
)
from models.estimation.shot_numbers.session_statistics import MIN_TREND_SHOTS, OF_BOTH_BALLS, SeriesSummary
from pipeline.reporting.text.text_formatting import format_meeting

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


SUMMARY_HEADINGS = ("number", "shots", "median", "own spread", "unit", "trend per shot")
# Instead of the median of directions that lead towards different rails, which none of the shots may have.
MIXED_DIRECTIONS = "of several directions"


def list_summary_cells(one: SeriesSummary, headings: Iterable[str]) -> tuple[str, ...]:
    """List the cells of a number in the table with `SUMMARY_HEADINGS`, for shots with these headings."""
    return (
        name_number(one.name), str(one.count), format_level(one, headings), format_own_spread(one),
        format_unit(one.unit), format_trend(one),
    )  # fmt: skip


def name_number(name: str) -> str:
    """Return the words for a number of a session, such as `object_length`; which ball, where both have one."""
    words = NUMBER_NAMES.get(name) or NUMBER_NAMES[name.removeprefix("object_")]
    if name.removeprefix("object_") in OF_BOTH_BALLS:
        return f"{words} {'of the object ball' if name.startswith('object_') else 'of the cue ball'}"
    return words


def format_level(one: SeriesSummary, headings: Iterable[str] = ()) -> str:
    """Format the median of a number over the shots as a number of one shot, with the digits of its measurement.

    Args:
        one: The summary.
        headings: Words for the headings of the shots, from `name_heading`.
    """
    median = ShotNumber(one.name, one.median, one.measurement, one.unit, True)
    if one.name == "direction":
        common = {*headings} - {""}
        return format_direction(median, common.pop(), has_sigma=False) if len(common) == 1 else MIXED_DIRECTIONS
    return format_number(median, has_sigma=False)


def format_trend(one: SeriesSummary) -> str:
    """Format the slope of a number over the shots with its interval; how many shots it needs where there are fewer."""
    if not math.isfinite(one.slope):
        return f"needs {MIN_TREND_SHOTS} shots"
    half = (one.slope_high - one.slope_low) / 2
    slope, low, high = (
        format_measured(value, half, DECIMALS[one.unit] + 1)[0] for value in (one.slope, one.slope_low, one.slope_high)
    )
    return f"{slope} ({low} to {high})"


def format_spread(one: SeriesSummary) -> str:
    """Format the spread over the shots with the digits of the measurement; empty below two shots."""
    return format_measured(one.spread, one.measurement, DECIMALS[one.unit])[0] if math.isfinite(one.spread) else ""


def format_own_spread(one: SeriesSummary) -> str:
    """Format the spread without the measurement errors; where these explain it, only their size as a limit."""
    if one.own_spread > 0:
        return format_measured(one.own_spread, one.measurement, DECIMALS[one.unit])[0]
    return f"below {format_measurement(one)}" if math.isfinite(one.own_spread) and one.measurement > 0 else ""


def format_measurement(one: SeriesSummary) -> str:
    """Format the standard deviation of a number in one shot, as its report does."""
    return format_measured(one.median, one.measurement, DECIMALS[one.unit])[1]


# Least probability of an event that is mentioned.
MIN_PROBABILITY = 0.1
# Least change of a share or an angle that is mentioned.
MIN_CHANGE = 1e-9
GOAL_WORDS = {
    "pot": "an object ball is potted and the cue ball is not",
    "carom": "the carom is made",
    "three-cushion": "the three-cushion carom is made",
}
NO_SPREAD = (
    "the uncertainty of the measurement alone, as if the player could repeat a stroke exactly; the player's own"
    " spread is not known"
)
SIDE_SPIN_WARNING = (
    "No contact models explain this whole shot, so its side spin is not known; paths after cushions are wide."
)


def format_what_if(document: dict[str, Any], naming: Naming) -> tuple[str, ...]:
    """Format the result of a what-if.

    Args:
        document: Content of what_if.json.
        naming: What balls, rails and pockets are called.

    Returns:
        Sentences: what was played, how probably it scores, what the real shot did, and what would happen; without a
        change, what did happen.
    """
    spread, real, changed = document["spread"], document["real"], document["changed"]
    goal, plays = _format_goal(document["goal"], naming), f"{document['draws']} plays"
    own = f"{100 * spread['speed']:.1f} % of the speed and {spread['angle_deg']:.2g} degrees"
    whose = "player" if spread["source"] == "user" else "session"
    measured = f"the spread of the {whose}, {own}, and the uncertainty of the measurement"
    scatter = NO_SPREAD if spread["source"] == "none" else measured
    did = f"The real shot {'scored' if real['scored'] else 'did not score'}."
    if parts := _list_changes(document):
        lines = [
            f"Played with {'; '.join(parts)}.",
            f"Played so, {goal} with a probability {_format_chance(changed)}; as it was struck, with a probability"
            f" {_format_chance(real)}. {did}",
            f"The two probabilities are shares of {plays} each, which differ by {scatter}.",
            f"Played so: {_list_events(changed, naming)}. These are the plays; the film is in the report.",
        ]
    else:
        lines = [
            f"Nothing is changed. In the film: {_list_events(real, naming)}.",
            f"{did} Played again as it was struck, {goal} with a probability {_format_chance(real)}.",
            f"The probability is a share of {plays}, which differ by {scatter}.",
        ]
    lines.append(
        f"In the image the real paths end with the clip, at {format_moment(document['clip_end'])}; those of the plays"
        f" go on until the balls rest, at most to {format_moment(document['play_end'])}."
    )
    if document["model"] == "segments":
        lines.append(SIDE_SPIN_WARNING)
    return tuple(lines)


def _list_events(shot: dict[str, Any], naming: Naming) -> str:
    """List the contacts and pots of a shot with their times."""
    events = [
        f"{naming.say(one['a'])} {format_meeting(one['kind'], one['b'], naming)} at"
        f" {format_time(one['t'], one['t_sigma'])}{format_doubt(one['probability'])}"
        for one in shot["events"]
        if one["probability"] >= MIN_PROBABILITY and one["kind"] != "rest"
    ]
    return ", ".join(events) or "nothing is met"


def format_what_if_question(document: dict[str, Any], naming: Naming) -> str:
    """Format the question of a what-if, such as `What if the cue ball is played with 5 % less speed: ...?`.

    Args:
        document: Content of what_if.json.
        naming: What balls are called.
    """
    parts = "; ".join(_list_changes(document))
    return f"What if {naming.say(document['cue'])} is played {f'with {parts}' if parts else 'as it was struck'}?"


def _format_goal(goal: dict[str, str], naming: Naming) -> str:
    """Format what must happen."""
    if goal["game"] != "pot" or not (goal.get("ball") or goal.get("pocket")):
        return GOAL_WORDS[goal["game"]]
    ball = naming.say(goal["ball"]) if goal["ball"] else "an object ball"
    return f"{ball} is potted" if not goal["pocket"] else f"{ball} falls into the {naming.name_pocket(goal['pocket'])}"


def _list_changes(document: dict[str, Any]) -> list[str]:
    """List what differs from the real stroke, with both values."""
    change, real, changed = document["change"], document["stroke"]["real"], document["stroke"]["changed"]
    parts = []
    if change["speed"] is not None or change["speed_factor"] != 1:
        share = changed["speed"] / real["speed"] - 1
        words = f"{100 * abs(share):.0f} % {'more' if share > 0 else 'less'} speed"
        doubt = "" if "speed" in real["observable"] else ", where it is not measurable"
        new, old = (
            format_number(ShotNumber("cue_speed", one["speed"], one["speed_sigma"], "m/s", True, ""), has_sigma=False)
            for one in (changed, real)
        )
        parts.append(f"{words}: {new} instead of {old}{doubt}")
    if abs(change["angle"]) > MIN_CHANGE:
        side = "right" if change["angle"] > 0 else "left"
        parts.append(f"the direction turned by {abs(change['angle']):g} degrees to the {side}")
    for name, sides in (("side", ("right side", "left side")), ("top", ("top", "back"))):
        if abs(changed[name] - real[name]) <= MIN_CHANGE:
            continue
        if name in real["observable"]:
            new, old = (
                f"{format_measured(abs(one[name]), one[f'{name}_sigma'], DECIMALS[''])[0]} {sides[one[name] < 0]}"
                for one in (changed, real)
            )
            is_sure = abs(real[name]) >= SURE_SIGMAS * real[f"{name}_sigma"]
            parts.append(f"{new} spin instead of {f'{old} spin' if is_sure else 'one that may be zero'}")
        else:
            added = changed[name] if change[name] is not None else change[f"{name}_added"]
            more = "" if change[name] is not None else " more than in the real stroke"
            parts.append(f"{abs(added):.2f} {sides[added < 0]} spin{more}, where it is not measurable")
    return parts


def _format_chance(play: dict[str, Any]) -> str:
    """Format a probability; one that its standard deviation does not tell from 0 or 1 by the limit alone."""
    p, sigma = play["probability"], play["probability_sigma"]
    if p < 2 * sigma:
        return f"below {math.ceil(100 * (p + 2 * sigma))} %"
    if 1 - p < 2 * sigma:
        return f"above {100 - math.ceil(100 * (1 - p + 2 * sigma))} %"
    return f"of {100 * p:.0f} ± {max(100 * sigma, 1):.0f} %"
