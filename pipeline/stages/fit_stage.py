"""The stages of the fit: events and motion from tracks, then published contact models for whole shots."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.by_hand.corrections import NO_CORRECTIONS, ContactCorrection, Corrections
from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.stages.place_stage import describe_facts


def motion_stage(options: FitOptions, corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that fits events and motion.

    Args:
        options: Options of the stage; those of whole shots are ignored.
        corrections: What a person corrected, of which contacts matter here.

    Returns:
        The stage `motion`, whose output is a `Fit` without contact models of whole shots.
    """
    own = replace(options, quick=False, laws=None, profile="")  # another search for models leaves the motion as it is
    marks = Corrections(contacts=corrections.contacts)
    run = partial(_fit_motion, marks.contacts)
    return Stage("motion", __name__, ("calibrate", "track"), Fit, run, own, describe_facts(marks))


def fit_stage(options: FitOptions) -> Stage:
    """Build the stage that fits published contact models to whole shots.

    Args:
        options: Options of the stage.

    Returns:
        The stage `fit`, whose output is the `Fit` of the stage `motion` with the contact models of whole shots.
    """
    return Stage("fit", __name__, ("calibrate", "track", "motion"), Fit, _fit_whole_shots, options)


def _fit_motion(
    marks: tuple[ContactCorrection, ...], inputs: Inputs, options: FitOptions, folder: Path, progress: Progress
) -> Fit:
    """Fit the contacts and the motion."""
    from models.estimation.reconstruction.fit_shot import fit_shot  # slow to import

    return fit_shot(inputs["track"], inputs["calibrate"], options, progress, marks)


def _fit_whole_shots(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Fit:
    """Fit published contact models to whole shots."""
    fit: Fit = inputs["motion"]
    if options.profile:
        from pipeline.io.tables.view_profile import list_profile_misfits

        misfits = list_profile_misfits(options.profile, inputs["calibrate"].cloth_lab, fit.parameters)
        fit = replace(fit, profile_misfits=misfits)
    if options.laws is False:
        return replace(fit, whole_shot_refusal="The fit of whole shots was switched off by --no-laws.")
    if options.quick and options.laws is None:
        return replace(fit, whole_shot_refusal="The fit of whole shots was left out by --quick.")
    from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws  # slow to import
    from pipeline.io.table_profile import parse_table_prior

    tracks, scene = inputs["track"], inputs["calibrate"]
    is_usable = bool(options.profile) and not fit.profile_misfits
    prior = parse_table_prior(options.profile) if is_usable else None
    return fit_shot_laws(fit, tracks, scene.table, options, prior)
