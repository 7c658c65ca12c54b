"""Report: one page to keep and send."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from detectors.options import DetectOptions
from detectors.select_detector import with_choice_noted
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.stages.render_stage import START


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """What the page says of the run."""

    title: str
    """Name of the clip."""
    slow: float
    """How many times slower the slow motion is."""
    settings: tuple[str, ...]
    """The options that reproduce the run."""
    detect: DetectOptions
    """How the balls were found."""


def report_stage(options: ReportOptions) -> Stage:
    return Stage("report", __name__, ("read", "calibrate", "track", "fit", "render"), None, _run, options)


def _run(inputs: Inputs, options: ReportOptions, folder: Path, progress: Progress) -> None:
    from pipeline.reporting.pages.run_report import (  # slow to import, and not needed while cached
        ReportFiles,
        write_report,
    )

    made = inputs["render"]
    start = float(json.loads((made / START).read_text(encoding="utf-8")))
    files = ReportFiles(made / "slow.mp4", made / "poster.png", options.slow, start)
    clip, scene, tracks, fit = (inputs[name] for name in ("read", "calibrate", "track", "fit"))
    scene = with_choice_noted(scene, options.detect)
    write_report(clip, scene, tracks, fit, files, options.title, options.settings, folder / "report.html")
