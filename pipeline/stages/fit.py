"""Fit: events and motion from tracks."""

from __future__ import annotations

from pathlib import Path

from models.fit import Fit
from models.fitting import FitOptions, fit_shot
from models.progress import Progress
from pipeline.stage import Inputs, Stage


def fit_stage(options: FitOptions) -> Stage:
    return Stage("fit", __name__, ("calibrate", "track"), Fit, _run, options)


def _run(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Fit:
    return fit_shot(inputs["track"], inputs["calibrate"], options, progress)
