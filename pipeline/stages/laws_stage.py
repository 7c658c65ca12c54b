"""The stage that fits published contact models to whole shots, where somebody asks for them.

The models of cushions and balls are selected in `models.estimation.whole_shot.table_fit.search_laws`, the cushion model
of a table that is learned from its contacts in `models.estimation.table_learning.cushion_learning.learn_cushions`.
"""

from __future__ import annotations

from pathlib import Path

from models.core.fit_result import WholeShotFit
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.shot import Shot
from pipeline.engine.stage import Inputs, Stage


def laws_stage(options: FitOptions) -> Stage:
    """Build the stage that fits published contact models to whole shots.

    Args:
        options: Options of the stage.

    Returns:
        The stage `laws`, whose output is a `WholeShotFit`.
    """
    return Stage("laws", __name__, ("explain",), WholeShotFit, _fit_laws, options)


def _fit_laws(inputs: Inputs, options: FitOptions, folder: Path, progress: Progress) -> WholeShotFit:
    """Fit published contact models to whole shots, on the table of the profile where it suits the clip."""
    from models.estimation.reconstruction.shot_views import view_shot
    from pipeline.io.shot_laws import fit_laws  # slow to import
    from pipeline.io.table_profile import parse_table_prior
    from pipeline.io.view_profile import list_profile_misfits

    shot: Shot = inputs["explain"]
    prior = None
    if options.profile and not list_profile_misfits(options.profile, shot.scene.cloth_lab, view_shot(shot).parameters):
        prior = parse_table_prior(options.profile)
    return fit_laws(shot, options, prior)
