"""The fit stage: estimates events and motion from tracks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.by_hand.corrections import NO_CORRECTIONS, ContactCorrection, Corrections
from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from pipeline.engine.stage import Inputs, Stage
from pipeline.stages.correction_facts import describe_facts


def fit_stage(options: FitOptions, corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that fits the motion.

    Args:
        options: Options of the stage.
        corrections: What a person corrected, of which contacts matter here.

    Returns:
        The stage `fit`, whose output is a `Fit`.
    """
    own = Corrections(contacts=corrections.contacts)
    run = partial(_fit_motion, own.contacts)
    return Stage("fit", __name__, ("calibrate", "track"), Fit, run, options, describe_facts(own))


def _fit_motion(
    marks: tuple[ContactCorrection, ...], inputs: Inputs, options: FitOptions, folder: Path, progress: Progress
) -> Fit:
    """Fit the contacts and the motion, and published contact models to whole shots."""
    from models.estimation.reconstruction.fit_shot import fit_shot  # slow to import

    tracks, scene = inputs["track"], inputs["calibrate"]
    fit = fit_shot(tracks, scene, options, progress, marks)
    if options.laws is False:
        return replace(fit, whole_shot_refusal="The fit of whole shots was switched off by --no-laws.")
    from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
    from pipeline.io.table_profile import parse_table_prior

    return fit_shot_laws(
        fit, tracks, scene.table, options, parse_table_prior(options.profile) if options.profile else None
    )
