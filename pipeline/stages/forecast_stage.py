"""The forecast stage: predicts the motion from a few moments of the shot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.options import ForecastOptions
from models.core.progress import Progress
from models.core.shot import Shot
from models.estimation.forecast.forecast_values import ForecastFans
from pipeline.engine.stage import Inputs, Stage


def forecast_stage(options: ForecastOptions) -> Stage:
    """Build the stage that forecasts the motion.

    Args:
        options: Options of the stage.

    Returns:
        The stage `forecast`, whose output is `ForecastFans`.
    """
    return Stage("forecast", __name__, ("explain",), ForecastFans, _forecast_moments, options)


def _forecast_moments(inputs: Inputs, options: ForecastOptions, folder: Path, progress: Progress) -> ForecastFans:
    """Predict where balls could have gone, and with a profile compare the rest of the shot; else no forecast."""
    if not (options.fans or options.profile):
        return ForecastFans(())
    from pipeline.io.run_views import view_run

    shot: Shot = inputs["explain"]
    fit = view_run(shot, None, options.profile)
    profile = "" if fit.profile_misfits else options.profile
    if not (options.fans or profile):
        return ForecastFans(())
    from models.estimation.forecast.forecast_check import compare_rest_of_shot, predict_fans  # slow to import
    from pipeline.io.table_profile import parse_learned_table

    learned = parse_learned_table(profile) if profile else None
    tracks, scene, events = shot.tracks, shot.scene, fit.events
    fans = predict_fans(tracks, scene, events, learned) if options.fans else ForecastFans(())
    return fans if learned is None else replace(fans, errors=compare_rest_of_shot(tracks, scene, events, learned))
