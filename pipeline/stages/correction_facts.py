"""What the stages need to know of corrections; apart from them, because a stage depends on all that it imports."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from models.core.corrections import BallMark, Corrections


def name_detections(corrections: Corrections) -> str:
    """Name the stage whose detections are tracked.

    Args:
        corrections: What a person corrected.

    Returns:
        `place` where a person placed balls, else `detect`.
    """
    return "place" if list_placed_balls(corrections) else "detect"


def describe_facts(corrections: Corrections) -> dict[str, Any]:
    """Describe the corrections that a stage depends on, for its cache key.

    Args:
        corrections: Those of the stage.

    Returns:
        JSON values by name; empty where there are none, so that uncorrected runs keep their keys.
    """
    return {name: value for name, value in asdict(corrections).items() if value}


def list_placed_balls(corrections: Corrections) -> tuple[BallMark, ...]:
    """List the balls that a person placed.

    Args:
        corrections: What a person corrected.

    Returns:
        The marks of placed balls.
    """
    return tuple(mark for mark in corrections.balls if mark.kind == "placed")
