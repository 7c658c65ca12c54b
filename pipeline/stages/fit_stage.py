"""The fit stage: estimates events and motion from tracks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage


def fit_stage(options: FitOptions) -> Stage:
    """Build the stage that fits the motion.

    Args:
        options: Options of the stage.

    Returns:
        The stage `fit`, whose output is a `Fit`.
    """
    return Stage("fit", __name__, ("calibrate", "track"), Fit, _fit_motion, options)


def _fit_motion(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Fit:
    """Fit the contacts and the motion, and published contact models to whole shots."""
    from models.estimation.reconstruction.fit_shot import fit_shot  # slow to import

    tracks, scene = inputs["track"], inputs["calibrate"]
    fit = fit_shot(tracks, scene, options, progress)
    if options.profile:
        from pipeline.io.tables.view_profile import list_profile_misfits

        fit = replace(fit, profile_misfits=list_profile_misfits(options.profile, scene.cloth_lab, fit.parameters))
    if options.laws is False:
        return replace(fit, whole_shot_refusal="The fit of whole shots was switched off by --no-laws.")
    from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
    from pipeline.io.table_profile import parse_table_prior

    is_usable = bool(options.profile) and not fit.profile_misfits
    prior = parse_table_prior(options.profile) if is_usable else None
    return fit_shot_laws(fit, tracks, scene.table, options, prior)
