"""The fit stage: estimates events and motion from tracks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.progress import Progress
from models.core.scene import Scene
from models.core.tracks import Tracks
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
    """Fit the contacts and the motion, published contact models to whole shots, and measure the shots."""
    from models.estimation.reconstruction.fit_shot import fit_with_solution  # slow to import
    from models.estimation.shot_numbers.measure_shots import measure_shots

    tracks, scene = inputs["track"], inputs["calibrate"]
    fit, solution = fit_with_solution(tracks, scene, options, progress)
    fit = _fit_laws(fit, tracks, scene, options)
    return fit if solution is None else replace(fit, shot_numbers=measure_shots(fit, solution, tracks, scene.table))


def _fit_laws(fit: Fit, tracks: Tracks, scene: Scene, options: FitOptions) -> Fit:
    """Fit published contact models to whole shots, unless they are switched off."""
    if options.laws is False:
        return replace(fit, whole_shot_refusal="The fit of whole shots was switched off by --no-laws.")
    from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
    from pipeline.io.table_profile import parse_table_prior

    return fit_shot_laws(
        fit, tracks, scene.table, options, parse_table_prior(options.profile) if options.profile else None
    )
