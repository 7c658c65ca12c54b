"""Fit: events and motion from tracks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage


def fit_stage(options: FitOptions) -> Stage:
    return Stage("fit", __name__, ("calibrate", "track"), Fit, _run, options)


def _run(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Fit:
    from models.estimation.reconstruction.fit_shot import fit_shot  # slow to import, and not needed while cached

    tracks, scene = inputs["track"], inputs["calibrate"]
    fit = fit_shot(tracks, scene, options, progress)
    if not (options.laws or options.profile):
        return replace(fit, lawless="It was not asked for: --laws.")
    from models.estimation.whole_shot.whole_shot_fit import with_laws
    from pipeline.io.table_profile import table_of

    return with_laws(fit, tracks, scene.table, options, table_of(options.profile) if options.profile else None)
