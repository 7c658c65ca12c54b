"""The stage that explains a shot."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.shot import Note, Shot
from pipeline.engine.stage import Inputs, Stage, describe_facts


def explain_stage(options: FitOptions, corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that explains the shot.

    Args:
        options: Options of the stage; those of whole shots are ignored.
        corrections: What a person corrected.

    Returns:
        The stage `explain`, whose output is a `Shot`.
    """
    own = replace(options, laws=False, profile="")  # whole shots are explained beside it
    run = partial(_explain, corrections)
    return Stage("explain", __name__, ("read", "calibrate", "track"), Shot, run, own, describe_facts(corrections))


def _explain(corrections: Corrections, inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Shot:
    """Explain the shot."""
    from models.estimation.reconstruction.explain_shot import explain  # slow to import

    notes = tuple(Note("incomplete_clip", note) for note in inputs["read"].missing_parts)
    return explain(inputs["track"], inputs["calibrate"], options, progress, corrections, notes)
