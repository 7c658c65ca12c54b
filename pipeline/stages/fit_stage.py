"""The stages of the fit: events and motion from tracks, then published contact models and numbers of whole shots."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.by_hand.corrections import NO_CORRECTIONS, ContactCorrection, Corrections
from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.joint_fit.fit_solution import ClipMotion
from pipeline.engine.stage import Inputs, Stage
from pipeline.stages.correction_facts import describe_facts


def motion_stage(options: FitOptions, corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that fits events and motion.

    Args:
        options: Options of the stage; those of whole shots are ignored.
        corrections: What a person corrected, of which contacts matter here.

    Returns:
        The stage `motion`, whose output is `ClipMotion` without contact models of whole shots.
    """
    own = replace(options, quick=False, laws=None, profile="")  # another search for models leaves the motion as it is
    marks = Corrections(contacts=corrections.contacts)
    run = partial(_fit_motion, marks.contacts)
    return Stage("motion", __name__, ("calibrate", "track"), ClipMotion, run, own, describe_facts(marks))


def fit_stage(options: FitOptions) -> Stage:
    """Build the stage that fits published contact models to whole shots, and measures the shots for players.

    Args:
        options: Options of the stage.

    Returns:
        The stage `fit`, whose output is the `Fit` of the stage `motion` with contact models and numbers of whole shots.
    """
    return Stage("fit", __name__, ("calibrate", "track", "motion"), Fit, _complete_fit, options)


def _fit_motion(
    marks: tuple[ContactCorrection, ...], inputs: Inputs, options: FitOptions, folder: Path, progress: Progress
) -> ClipMotion:
    """Fit the contacts and the motion."""
    from models.estimation.reconstruction.fit_shot import fit_with_solution  # slow to import

    return ClipMotion(*fit_with_solution(inputs["track"], inputs["calibrate"], options, progress, marks))


def _complete_fit(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Fit:
    """Fit published contact models to whole shots, and measure the shots."""
    motion, tracks, scene = (inputs[name] for name in ("motion", "track", "calibrate"))
    fit: Fit = motion.fit
    if options.profile:
        from pipeline.io.tables.view_profile import list_profile_misfits  # slow to import

        fit = replace(fit, profile_misfits=list_profile_misfits(options.profile, scene.cloth_lab, fit.parameters))
    fit = _fit_laws(fit, tracks, scene, options)
    if motion.solution is None:
        return fit
    from models.estimation.shot_numbers.measure_shots import measure_shots  # slow to import

    return replace(fit, shot_numbers=measure_shots(fit, motion.solution, tracks, scene.table))


def fits_whole_shots(options: FitOptions) -> bool:
    """Find out what a run fits.

    Args:
        options: Options of the fit.

    Returns:
        Whether it fits published contact models to whole shots.
    """
    return not options.quick if options.laws is None else options.laws


def _fit_laws(fit: Fit, tracks: Tracks, scene: Scene, options: FitOptions) -> Fit:
    """Fit published contact models to whole shots, unless they are switched off."""
    if options.laws is False:
        return replace(fit, whole_shot_refusal="The fit of whole shots was switched off by --no-laws.")
    if options.quick and options.laws is None:
        return replace(fit, whole_shot_refusal="The fit of whole shots was left out by --quick.")
    from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws  # slow to import
    from pipeline.io.table_profile import parse_table_prior

    is_usable = bool(options.profile) and not fit.profile_misfits
    prior = parse_table_prior(options.profile) if is_usable else None
    return fit_shot_laws(fit, tracks, scene.table, options, prior)
