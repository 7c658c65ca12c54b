"""Sentences about a shot that is played otherwise."""

from __future__ import annotations

from math import ceil
from typing import Any

from models.core.naming import Naming
from models.core.number_format import format_doubt, format_moment, format_speed, format_time
from pipeline.reporting.text.number_sentences import SURE_SIGMAS
from pipeline.reporting.text.text_formatting import format_meeting

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
    "the uncertainty of the measurement alone, as if the player could repeat a stroke exactly; --spread or --session"
    " add the player's own"
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
        parts.append(f"{words}: {format_speed(changed['speed'])} instead of {format_speed(real['speed'])}{doubt}")
    if abs(change["angle"]) > MIN_CHANGE:
        side = "right" if change["angle"] > 0 else "left"
        parts.append(f"the direction turned by {abs(change['angle']):g} degrees to the {side}")
    for name, sides in (("side", ("right side", "left side")), ("top", ("top", "back"))):
        if abs(changed[name] - real[name]) <= MIN_CHANGE:
            continue
        if name in real["observable"]:
            new, old = (f"{abs(one[name]):.2f} {sides[one[name] < 0]}" for one in (changed, real))
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
        return f"below {ceil(100 * (p + 2 * sigma))} %"
    if 1 - p < 2 * sigma:
        return f"above {100 - ceil(100 * (1 - p + 2 * sigma))} %"
    return f"of {100 * p:.0f} ± {max(100 * sigma, 1):.0f} %"
