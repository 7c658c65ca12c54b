"""The stage of the page of a run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from detectors.detect_options import DetectOptions
from detectors.select_detector import note_selection
from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.shot import Shot
from models.estimation.forecast.forecast_values import ForecastErrors
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.run_views import list_view_inputs, view_inputs
from pipeline.reporting.text.fit_sentences import note_corrections
from pipeline.stages.render_stage import SLOW_FILE, START_FILE


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """Options of the report."""

    title: str
    """Name of the clip."""
    slow: float
    """Slow-down factor of the slow motion."""
    settings: tuple[str, ...]
    """Options of the command line that reproduce the run."""
    detect: DetectOptions
    """Options of the detection."""
    fit: FitOptions
    """Options of the explanation."""


def report_stage(options: ReportOptions) -> Stage:
    """Build the stage that writes the report.

    Args:
        options: Options of the stage.

    Returns:
        The stage `report`, whose output is a folder with report.html and summary.json.
    """
    needs = ("read", *list_view_inputs(options.fit), "poster")
    return Stage("report", __name__, needs, None, _write_report, options)


def _write_report(inputs: Inputs, options: ReportOptions, folder: Path, progress: Progress) -> None:
    """Write report.html, which plays the slow motion that lies beside it."""
    from pipeline.reporting.pages.run_report import ReportFiles, write_report  # slow to import

    drawn = inputs["poster"]
    start = float(json.loads((drawn / START_FILE).read_text(encoding="utf-8")))
    files = ReportFiles(SLOW_FILE, drawn / "poster.png", options.slow, start)
    shot: Shot = inputs["explain"]
    scene = note_corrections(note_selection(shot.scene, options.detect), shot.corrections, shot.tracks)
    fit = view_inputs(inputs, options.fit)
    write_report(
        inputs["read"], scene, shot.tracks, fit, files, options.title, options.settings, folder / "report.html",
        _compare_with_profile(shot, fit, options.fit.profile),
    )  # fmt: skip


def _compare_with_profile(shot: Shot, fit: Fit, profile: str) -> ForecastErrors | None:
    """Compare the rest of a shot with what a table profile predicts; None without a profile that fits the clip."""
    if not profile or fit.profile_misfits:
        return None
    from models.estimation.forecast.forecast_check import compare_rest_of_shot  # slow to import
    from pipeline.io.table_profile import parse_learned_table

    return compare_rest_of_shot(shot.tracks, shot.scene, fit.events, parse_learned_table(profile))
