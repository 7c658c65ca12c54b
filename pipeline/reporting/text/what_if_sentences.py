"""Sentences about a shot that is played otherwise."""

from __future__ import annotations

from math import ceil
from typing import Any

from pipeline.reporting.text.number_format import EXTREME_PROBABILITY, format_probability

MIN_PROBABILITY = 0.1
"""Least probability of an event that is mentioned."""
MIN_CHANGE = 1e-9
"""Least change of a share or an angle that is mentioned."""
GOAL_WORDS = {
    "pot": "a ball is potted",
    "carom": "the carom is made",
    "three-cushion": "the three-cushion carom is made",
}
EVENT_WORDS = {
    "ball": "{a} meets {b}",
    "cushion": "{a} meets the {b} cushion",
    "pocket": "{a} falls into the {b} pocket",
}
SPREAD_WORDS = {
    "user": "the player's spread, {speed} % of the speed and {angle:.2g} degrees, and the uncertainty of the"
    " measurement",
    "session": "the spread of the session, {speed} % of the speed and {angle:.2g} degrees, and the uncertainty of the"
    " measurement",
    "none": "the uncertainty of the measurement alone, as if the player could repeat a stroke exactly; --spread or"
    " --session add the player's own",
}
SIDE_SPIN_WARNING = (
    "No contact models explain this whole shot, so its side spin is not known; paths after cushions are wide."
)


def format_what_if(document: dict[str, Any]) -> list[str]:
    """Format the result of a what-if.

    Args:
        document: Content of what_if.json.

    Returns:
        Sentences: what was played, how probably it scores, what the real shot did, and what would happen.
    """
    spread, real, changed = document["spread"], document["real"], document["changed"]
    goal = GOAL_WORDS[document["goal"]["game"]]
    scatter = SPREAD_WORDS[spread["source"]].format(speed=f"{100 * spread['speed']:.1f}", angle=spread["angle_deg"])
    lines = [
        _format_change(document),
        f"Played so, {goal} with a probability {_format_chance(changed)}.",
        f"As it was struck, {goal} with a probability {_format_chance(real)}; the real shot"
        f" {'scored' if real['scored'] else 'did not score'}.",
        f"The probabilities are shares of {document['draws']} plays, which differ by {scatter}.",
    ]
    events = [
        f"{one['t']:.2f} s {EVENT_WORDS[one['kind']].format(**one)}{_format_doubt(one['probability'])}"
        for one in changed["events"]
        if one["probability"] >= MIN_PROBABILITY and one["kind"] in EVENT_WORDS
    ]
    lines.append(f"Played so: {', '.join(events)}." if events else "Played so, nothing is met.")
    lines.append(
        f"The real paths end with the clip, at {document['clip_end']:.2f} s; the others go on until the balls rest, at"
        f" most to {document['play_end']:.2f} s."
    )
    if document["model"] == "segments":
        lines.append(SIDE_SPIN_WARNING)
    return lines


def _format_doubt(probability: float) -> str:
    """Format the probability of an event in brackets; empty where it is as good as certain."""
    return "" if probability > 1 - EXTREME_PROBABILITY else f" ({format_probability(probability)})"


def _format_change(document: dict[str, Any]) -> str:
    """Format what differs from the real stroke, with both values."""
    change, real, changed = document["change"], document["stroke"]["real"], document["stroke"]["changed"]
    parts = []
    if change["speed"] is not None or change["speed_factor"] != 1:
        share = changed["speed"] / real["speed"] - 1
        words = f"{100 * abs(share):.0f} % {'more' if share > 0 else 'less'} speed"
        parts.append(f"{words}: {changed['speed']:.2f} m/s instead of {real['speed']:.2f} m/s")
    if abs(change["angle"]) > MIN_CHANGE:
        side = "right" if change["angle"] > 0 else "left"
        parts.append(f"the direction turned by {abs(change['angle']):g} degrees to the {side}")
    for name, sides in (("side", ("right", "left")), ("top", ("top", "back"))):
        if abs(changed[name] - real[name]) > MIN_CHANGE:
            texts = [f"{abs(one[name]):.2f} {sides[one[name] < 0]}" for one in (changed, real)]
            parts.append(f"{name} spin {texts[0]} instead of {texts[1]}")
    return f"Played with {'; '.join(parts)}." if parts else "Played as it was struck: nothing is changed."


def _format_chance(play: dict[str, Any]) -> str:
    """Format a probability; one that its standard deviation does not tell from 0 or 1 by the limit alone."""
    p, sigma = play["probability"], play["probability_sigma"]
    if p < 2 * sigma:
        return f"below {ceil(100 * (p + 2 * sigma))} %"
    if 1 - p < 2 * sigma:
        return f"above {100 - ceil(100 * (1 - p + 2 * sigma))} %"
    return f"of {100 * p:.0f} ± {max(100 * sigma, 1):.0f} %"
