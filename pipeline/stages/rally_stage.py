"""The rally stage: explains a rally by flights in space."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.progress import Progress
from models.core.rally import Rally
from pipeline.engine.stage import Inputs, NoOptions, Stage


def rally_stage() -> Stage:
    """Build the stage that explains a rally.

    Returns:
        The stage `rally`, whose output is a `Rally`.
    """
    return Stage("rally", __name__, ("read", "court", "candidates"), Rally, _explain_rally, NoOptions())


def _explain_rally(inputs: Inputs, options: NoOptions, folder: Path, progress: Progress) -> Rally:
    """Explain the rally."""
    from models.estimation.rally.explain_rally import explain_rally  # slow to import

    clip = inputs["read"]
    frame = clip.distinct_frames
    rally = explain_rally(inputs["court"], inputs["candidates"], frame, clip.times_of(frame), progress)
    return replace(rally, notes=(*rally.notes, "incomplete_clip")) if clip.missing_parts else rally
