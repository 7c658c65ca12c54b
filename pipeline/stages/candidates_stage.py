"""The candidates stage: finds where the ball or shuttle of a rally may be seen."""

from __future__ import annotations

from pathlib import Path

from models.core.progress import Progress
from models.core.rally import BallCandidates
from pipeline.engine.stage import Inputs, NoOptions, Stage


def candidates_stage() -> Stage:
    """Build the stage that finds candidates.

    Returns:
        The stage `candidates`, whose output is `BallCandidates`.
    """
    return Stage("candidates", __name__, ("read", "court"), BallCandidates, _find_candidates, NoOptions())


def _find_candidates(inputs: Inputs, options: NoOptions, folder: Path, progress: Progress) -> BallCandidates:
    """Find the candidates in all frames."""
    from detectors.flying.find_candidates import find_candidates  # slow to import

    return find_candidates(inputs["read"], inputs["court"], progress)
