"""Fit: events and motion from tracks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.fit import Fit
from models.options import FitOptions
from models.progress import Progress
from pipeline.stage import Inputs, Stage


def fit_stage(options: FitOptions) -> Stage:
    return Stage("fit", __name__, ("calibrate", "track"), Fit, _run, options)


def _run(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Fit:
    from models.fitting.fit_shot import fit_shot  # slow to import, and not needed while cached

    tracks, scene = inputs["track"], inputs["calibrate"]
    fit = fit_shot(tracks, scene, options, progress)
    if not (options.laws or options.profile):
        return replace(fit, lawless="It was not asked for: --laws.")
    from models.billiards.whole_shots import with_laws
    from pipeline.profile import table_of

    return with_laws(fit, tracks, scene.table, options, table_of(options.profile) if options.profile else None)
