"""Text for events, fitted parameters and models, trust levels, file names and errors."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape

from models.core.errors import TruerollError
from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.naming import Naming, join_names
from models.core.number_format import format_speed, format_time

# Textbook ranges of parameters: Alciatore, technical proofs, billiards.colostate.edu; Marlow, The Physics of Pocket
# Billiards, 1995.
TEXTBOOK_RANGES = {
    "rolling_resistance.mu": (0.005, 0.015),
    "sliding_friction.mu": (0.15, 0.25),
    "spin_decay.rate": (5.0, 15.0),
    "cushion_restitution.e": (0.75, 0.98),
    "ball_restitution.e": (0.92, 0.98),
}

# Words for the speed of an event: the component along the line of a contact is not the speed of a ball.
SPEED_WORDS = {
    "strike": " and leaves at {}", "ball": ", closing at {}", "cushion": ", {} straight into it", "pocket": " at {}",
}  # fmt: skip
# m/s below which an event is described without its speed, which would be printed as 0.00.
MIN_REPORTED_SPEED = 0.005


def format_event(events: Events, k: int, naming: Naming) -> str:
    """Format event k as a sentence without a full stop: `name_event`, and which speed, if it is large enough."""
    words, speed = SPEED_WORDS.get(events.kind[k], ""), float(events.speed[k])
    shown = words.format(format_speed(speed)) if speed >= MIN_REPORTED_SPEED else ""
    return start_sentence(name_event(events, k, naming)) + shown


def name_event(events: Events, k: int, naming: Naming) -> str:
    """Name event k by its balls and what happened, such as `the cue ball and red 3 touch`."""
    a, b = naming.say(events.a[k]), events.b[k]
    is_touch = events.kind[k] == "ball"  # neither ball did it to the other
    again = " again" * is_repeated(events, k)
    return f"{a} and {naming.say(b)} touch{again}" if is_touch else f"{a} {format_meeting(events.kind[k], b, naming)}"


def is_repeated(events: Events, k: int) -> bool:
    """Return whether event k is a contact of two balls that have touched before."""
    pairs = [{a, b} for a, b in zip(events.a, events.b, strict=True)]
    earlier = [j for j in range(len(events)) if events.kind[j] == "ball" and events.t[j] < events.t[k]]
    return events.kind[k] == "ball" and any(pairs[j] == pairs[k] for j in earlier)


def format_no_events(fit: Fit) -> str:
    """Say what a clip without events shows."""
    moving = [fit.naming.say(ball) for k, ball in enumerate(fit.trajectory.ids) if fit.moving[:, k].any()]
    if not moving:
        return "No ball moves in this clip."
    verb = "moves" if len(moving) == 1 else "move"
    return f"{start_sentence(join_names(moving))} {verb}; no strike, contact, pot or rest is seen."


def format_meeting(kind: str, other: str, naming: Naming) -> str:
    """Format what a ball does, such as `touches red 3`, `hits the far long rail` or `falls into the far-left pocket`.

    Args:
        kind: Kind of the event, one of `EVENT_KINDS`.
        other: Id of the other ball, or canonical name of the cushion or pocket; empty for a strike and a rest.
        naming: What balls, rails and pockets are called.
    """
    if kind in ("strike", "rest"):
        return "is struck" if kind == "strike" else "comes to rest"
    if kind == "pocket":
        return f"falls into the {naming.name_pocket(other)}"
    return f"{'touches' if kind == 'ball' else 'hits'} {naming.say(other)}"


def start_sentence(text: str) -> str:
    """Begin a text with a capital letter."""
    return text[:1].upper() + text[1:]


def format_event_time(events: Events, k: int) -> str:
    """Format the time of event k with its standard deviation."""
    return format_time(float(events.t[k]), float(events.t_sigma[k]))


def format_textbook_range(name: str) -> str:
    """Format the textbook range of a fitted parameter.

    Args:
        name: Name of the parameter, `effect.parameter`.

    Returns:
        The range; empty if there is none.
    """
    usual = TEXTBOOK_RANGES.get(name)
    return "" if usual is None else f"{usual[0]:g} to {usual[1]:g}"


def format_parameter_name(name: str) -> str:
    """Format the name of a parameter for readers.

    Args:
        name: Name of the parameter, `effect.parameter`.

    Returns:
        Effect and parameter, separated by a comma.
    """
    effect, _, letter = name.partition(".")
    return f"{effect.replace('_', ' ')}, {letter.replace('_', ' ')}"


def escape_text(path: Path | str) -> str:
    """Make a file name safe to print and to write.

    Args:
        path: File name, which may hold bytes that are no UTF-8 and control characters.

    Returns:
        The name with every unprintable character replaced by U+FFFD.
    """
    text = os.fsencode(path).decode("utf-8", "replace")
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


def name_folders(folders: Sequence[Path]) -> str:
    """Name folders in a heading: all of up to three, the first and the last of more."""
    names = [escape_text(folder.resolve().name) for folder in folders]
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} to {names[-1]}"


# Options by their names on the page, where these are others; what else can be done there, by the names of errors.
PAGE_OPTIONS = {"at": "The moment", "angle": "The direction", "side": "The side spin", "top": "The top spin",
                "spread": "The player's spread", "on": "The ball on", "corners": "The corners of the table",
                "edge": "The edge of the ball"}  # fmt: skip
PAGE_REMEDIES = {
    "corners": "film it with all four cushions in view, or mark its corners",
    "court corners": "mark the corners of the court",
    "balls": "film the table from higher up, or mark its corners",
}


def name_page_option(option: str) -> str:
    """Name an option at the start of a sentence of the page."""
    return PAGE_OPTIONS.get(option) or f"The {option.replace('-', ' ')}"


def format_error(error: Exception, *, for_page: bool = False) -> str:
    """Format an exception as one line for the user.

    Args:
        error: Any exception; the messages of a TruerollError are written for users.
        for_page: Whether that is the user of the page, who has no options, instead of that of a command.

    Returns:
        One sentence; an unexpected exception is marked as such.
    """
    if isinstance(error, TruerollError):
        sentence = error.word(name_page_option, PAGE_REMEDIES) if for_page else str(error)
        return " ".join(sentence.split())
    if isinstance(error, OSError):
        place = f" ({error.filename})" if error.filename else ""
        return f"A file could not be read or written: {error.strerror or error}{place}"
    words = " ".join(str(error).split())
    return f"An unexpected error occurred: {type(error).__name__}: {words}. Please report it with --debug"


def summarize_trust(trust: Trust) -> dict[str, object]:
    """Convert a trust level to the form of scene.json and --json.

    Args:
        trust: Level and reasons.

    Returns:
        Keys `light` and `why`.
    """
    return {"light": trust.level, "why": list(trust.reasons)}


def format_trust_line(trust: Trust) -> str:
    """Format a trust level for the terminal.

    Args:
        trust: Level and reasons.

    Returns:
        One line in rich's markup.
    """
    colour = {"green": "green", "amber": "yellow", "red": "red"}[trust.level]
    return f"[{colour}]●[/] trust: {trust.level}. " + escape(" ".join(trust.reasons))


def format_law(name: str) -> str:
    """Format the name of a contact model for readers, such as "Han 2005" for `han_2005`."""
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]
