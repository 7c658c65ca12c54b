"""The place stage: adds the balls that a person placed to those of the detector."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from models.core.corrections import BallMark, Corrections
from models.core.detections import MarkedDetections
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, NoOptions, Stage, describe_facts


def place_stages(corrections: Corrections) -> tuple[Stage, ...]:
    """Build the stage that adds placed balls.

    Args:
        corrections: What a person corrected.

    Returns:
        The stage `place`, whose output is `MarkedDetections`; nothing where no ball was placed.
    """
    placed = tuple(mark for mark in corrections.balls if mark.kind == "placed")
    if not placed:
        return ()
    run, facts = partial(_add_balls, placed), describe_facts(Corrections(balls=placed))
    return (Stage("place", __name__, ("read", "calibrate", "detect"), MarkedDetections, run, NoOptions(), facts),)


def _add_balls(
    placed: tuple[BallMark, ...], inputs: Inputs, options: NoOptions, folder: Path, progress: Progress
) -> MarkedDetections:
    """Measure and follow the placed balls."""
    from detectors.placed_balls import add_placed_balls  # slow to import

    return add_placed_balls(inputs["detect"], inputs["read"], inputs["calibrate"], placed, progress)
