"""Sentences about a shot that is played otherwise."""

from __future__ import annotations

from typing import Any

MIN_PROBABILITY = 0.1
"""Least probability of an event that is mentioned."""
GAME_WORDS = {
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
    "user": "with the player's spread of {speed:.1%} of the speed and {angle:.2g} degrees",
    "session": "with the spread of the session, {speed:.1%} of the speed and {angle:.2g} degrees",
    "none": "by the uncertainty of the measurement alone, as if the player could repeat the stroke exactly",
}
SIDE_SPIN_WARNING = (
    "No contact models explain this whole shot, so its side spin is not known; paths after cushions are wide."
)


def format_what_if(document: dict[str, Any]) -> list[str]:
    """Format the result of a what-if.

    Args:
        document: Content of what_if.json.

    Returns:
        Sentences: what would happen, and how probably it scores.
    """
    spread = document["spread"]
    words = SPREAD_WORDS[spread["source"]].format(speed=spread["speed"], angle=spread["angle_deg"])
    real, changed = document["real"], document["changed"]
    what = GAME_WORDS[document["goal"]["game"]]
    lines = [
        f"Probability that {what}: {_format_probability(changed)} otherwise, {_format_probability(real)} as it was"
        f" struck, {words}.",
        f"The real shot {'scored' if real['scored'] else 'did not score'}.",
    ]
    events = [
        f"{EVENT_WORDS[one['kind']].format(**one)} ({one['probability']:.0%})"
        for one in changed["events"]
        if one["probability"] >= MIN_PROBABILITY and one["kind"] in EVENT_WORDS
    ]
    lines.append(f"Otherwise: {', '.join(events)}." if events else "Otherwise nothing is met.")
    if document["model"] == "segments":
        lines.append(SIDE_SPIN_WARNING)
    return lines


def _format_probability(play: dict[str, Any]) -> str:
    return f"{100 * play['probability']:.0f} ± {100 * play['probability_sigma']:.0f} %"
