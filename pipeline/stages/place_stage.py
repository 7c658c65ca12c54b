"""The place stage: adds the balls that a person placed to those of the detector."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from models.core.by_hand.corrections import BallMark, Corrections
from models.core.detections import MarkedDetections
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage


@dataclass(frozen=True, slots=True)
class PlaceOptions:
    """Options of the stage, which has none beside the corrections."""


def name_detections(corrections: Corrections) -> str:
    """Name the stage whose detections are tracked.

    Args:
        corrections: What a person corrected.

    Returns:
        `place` where a person placed balls, else `detect`.
    """
    return "place" if _list_placed_balls(corrections) else "detect"


def place_stages(corrections: Corrections) -> tuple[Stage, ...]:
    """Build the stage that adds placed balls.

    Args:
        corrections: What a person corrected.

    Returns:
        The stage `place`, whose output is `MarkedDetections`; nothing where no ball was placed.
    """
    placed = _list_placed_balls(corrections)
    if not placed:
        return ()
    run, facts = partial(_add_balls, placed), describe_facts(Corrections(balls=placed))
    return (Stage("place", __name__, ("read", "calibrate", "detect"), MarkedDetections, run, PlaceOptions(), facts),)


def describe_facts(corrections: Corrections) -> dict[str, Any]:
    """Describe the corrections that a stage depends on, for its cache key.

    Args:
        corrections: Those of the stage.

    Returns:
        JSON values by name; empty where there are none, so that uncorrected runs keep their keys.
    """
    return {name: value for name, value in asdict(corrections).items() if value}


def _list_placed_balls(corrections: Corrections) -> tuple[BallMark, ...]:
    return tuple(mark for mark in corrections.balls if mark.kind == "placed")


def _add_balls(
    placed: tuple[BallMark, ...], inputs: Inputs, options: PlaceOptions, folder: Path, progress: Progress
) -> MarkedDetections:
    """Measure and follow the placed balls."""
    from detectors.placed_balls import add_placed_balls  # slow to import

    return add_placed_balls(inputs["detect"], inputs["read"], inputs["calibrate"], placed, progress)
