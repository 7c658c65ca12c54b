"""What happened and what was fitted, in words."""

from __future__ import annotations

import os
from pathlib import Path

from models.core.errors import TruerollError
from models.core.events import Events

TEXTBOOK = {
    "rolling_resistance.mu": (0.005, 0.015),
    "sliding_friction.mu": (0.15, 0.25),
    "spin_decay.rate": (5.0, 15.0),
    "cushion_restitution.e": (0.75, 0.98),
    "ball_restitution.e": (0.92, 0.98),
}
"""Usual ranges: Alciatore, technical proofs, billiards.colostate.edu; Marlow, The Physics of Pocket Billiards, 1995."""

LEAST_SPEED = 0.005
"""m/s below which 0.00 would be said, which is no way to touch."""


def event_sentence(events: Events, k: int) -> str:
    """Event k in words: who, what and how fast."""
    what = {
        "strike": f"{events.a[k]} is struck",
        "ball": f"{events.a[k]} and {events.b[k]} touch",
        "cushion": f"{events.a[k]} hits the {events.b[k]} cushion",
        "pocket": f"{events.a[k]} falls into the {events.b[k]} pocket",
        "rest": f"{events.a[k]} comes to rest",
    }[events.kind[k]]
    return what + (f" at {events.speed[k]:.2f} m/s" if events.speed[k] >= LEAST_SPEED else "")


def event_time(events: Events, k: int) -> str:
    """When event k happened, with its error."""
    return f"{events.t[k]:.4f} s ± {1000 * events.t_sigma[k]:.1f} ms"


def textbook_range(name: str) -> tuple[float, float] | None:
    """The usual range of a fitted parameter; None where none is known."""
    return TEXTBOOK.get(name)


def parameter_range(name: str) -> str:
    """The textbook range of a fitted parameter in words, empty where none is known."""
    usual = TEXTBOOK.get(name)
    return "" if usual is None else f"{usual[0]:g} to {usual[1]:g}"


def parameter_words(name: str) -> str:
    """A parameter's name as words: its effect, and its letter."""
    effect, _, letter = name.partition(".")
    return f"{effect.replace('_', ' ')}, {letter.replace('_', ' ')}"


def told(path: Path | str) -> str:
    """A name as it can be shown and written anywhere: what is no text or would move the cursor becomes a sign."""
    text = os.fsencode(path).decode("utf-8", "replace")
    return "".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in text)


def one_sentence(error: Exception) -> str:
    """What went wrong, in one line: our own words, the system's about a file, or that it was not foreseen."""
    if isinstance(error, TruerollError):
        return " ".join(str(error).split())
    if isinstance(error, OSError):
        place = f" ({error.filename})" if error.filename else ""
        return f"A file could not be read or written: {error.strerror or error}{place}"
    words = " ".join(str(error).split())
    return f"Something unforeseen went wrong: {type(error).__name__}: {words}. Please report it with --debug"
