"""The rally stage: explains a rally by flights in space."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.progress import Progress
from models.core.rally import Rally
from pipeline.engine.stage import Inputs, NoOptions, Stage, describe_facts


def rally_stage(corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that explains a rally.

    Args:
        corrections: What a person corrected.

    Returns:
        The stage `rally`, whose output is a `Rally`.
    """
    own = Corrections(balls=corrections.balls, events=corrections.events)
    run, needs = partial(_explain_rally, own), ("read", "court", "candidates")
    return Stage("rally", __name__, needs, Rally, run, NoOptions(), describe_facts(own))


def _explain_rally(
    corrections: Corrections, inputs: Inputs, options: NoOptions, folder: Path, progress: Progress
) -> Rally:
    """Explain the rally."""
    from models.estimation.rally.explain_rally import explain_rally  # slow to import

    clip = inputs["read"]
    frame = clip.distinct_frames
    rally = explain_rally(inputs["court"], inputs["candidates"], frame, clip.times_of(frame), progress, corrections)
    return replace(rally, notes=(*rally.notes, "incomplete_clip")) if clip.missing_parts else rally
