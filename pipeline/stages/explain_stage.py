"""The stages that explain a shot: the shot itself, and the published contact models of whole shots where asked for."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.fit_result import WholeShotFit
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.shot import Note, Shot
from pipeline.engine.stage import Inputs, Stage
from pipeline.stages.correction_facts import describe_facts
from video.io.clip import INCOMPLETE_PREFIXES


def explain_stage(options: FitOptions, corrections: Corrections = NO_CORRECTIONS) -> Stage:
    """Build the stage that explains the shot.

    Args:
        options: Options of the stage; those of whole shots are ignored.
        corrections: What a person corrected.

    Returns:
        The stage `explain`, whose output is a `Shot`.
    """
    own = replace(options, laws=False, profile="")  # whole shots are explained beside it
    run = partial(_explain, corrections)
    return Stage("explain", __name__, ("read", "calibrate", "track"), Shot, run, own, describe_facts(corrections))


def laws_stage(options: FitOptions) -> Stage:
    """Build the stage that fits published contact models to whole shots.

    Args:
        options: Options of the stage.

    Returns:
        The stage `laws`, whose output is a `WholeShotFit`.
    """
    return Stage("laws", __name__, ("explain",), WholeShotFit, _fit_laws, options)


def _explain(corrections: Corrections, inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> Shot:
    """Explain the shot."""
    from models.estimation.reconstruction.explain_shot import explain  # slow to import

    remarks = inputs["read"].notes
    notes = tuple(Note("incomplete_clip", note) for note in remarks if note.startswith(INCOMPLETE_PREFIXES))
    return explain(inputs["track"], inputs["calibrate"], options, progress, corrections, notes)


def _fit_laws(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> WholeShotFit:
    """Fit published contact models to whole shots, on the table of the profile where it suits the clip."""
    from models.estimation.reconstruction.shot_views import view_shot
    from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws  # slow to import
    from pipeline.io.table_profile import parse_table_prior
    from pipeline.io.view_profile import list_profile_misfits

    shot: Shot = inputs["explain"]
    prior = None
    if options.profile and not list_profile_misfits(options.profile, shot.scene.cloth_lab, view_shot(shot).parameters):
        prior = parse_table_prior(options.profile)
    return fit_shot_laws(view_shot(shot), shot.tracks, shot.scene.table, options, prior)
