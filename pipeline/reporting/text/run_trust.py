"""Trust level of a run: that of its fit, reduced if the clip is incomplete."""

from __future__ import annotations

from rich.markup import escape

from models.core.fit_result import Fit, Trust
from video.io.clip import INCOMPLETE_PREFIXES, Clip


def assess_run_trust(clip: Clip, fit: Fit) -> Trust:
    """Assess the trust level of a run.

    Args:
        clip: The clip with its notes.
        fit: The fit with its own trust level.

    Returns:
        The trust level of the fit; at most amber if the clip is incomplete, because its later part is missing.
    """
    missing = tuple(f"The clip is incomplete: {note}." for note in clip.notes if note.startswith(INCOMPLETE_PREFIXES))
    if not missing:
        return fit.trust
    return Trust("amber" if fit.trust.level == "green" else fit.trust.level, (*missing, *fit.trust.reasons))


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
