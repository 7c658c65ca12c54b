"""How far to trust a run: the verdict on the fit, and what was wrong with the clip itself."""

from __future__ import annotations

from rich.markup import escape

from models.core.fit_result import Fit, Trust
from video.io.clip import INCOMPLETE, Clip


def run_trust(clip: Clip, fit: Fit) -> Trust:
    """The trust of the fit; amber at best where the clip is not whole, for what came after is not known."""
    missing = tuple(f"The clip is not whole: {note}." for note in clip.notes if note.startswith(INCOMPLETE))
    if not missing:
        return fit.trust
    return Trust("amber" if fit.trust.light == "green" else fit.trust.light, (*missing, *fit.trust.reasons))


def trust_facts(trust: Trust) -> dict[str, object]:
    """The light and why, as files and --json have them."""
    return {"light": trust.light, "why": list(trust.reasons)}


def trust_line(trust: Trust) -> str:
    """The light and why, in rich's markup for the terminal."""
    colour = {"green": "green", "amber": "yellow", "red": "red"}[trust.light]
    return f"[{colour}]●[/] trust: {trust.light}. " + escape(" ".join(trust.reasons))
