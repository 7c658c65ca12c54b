"""The forecast stage: predicts the motion from a few moments of the shot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.options import ForecastOptions
from models.core.progress import Progress
from models.estimation.forecast.forecast_values import ForecastFans
from pipeline.engine.stage import Inputs, Stage


def forecast_stage(options: ForecastOptions) -> Stage:
    """Build the stage that forecasts the motion.

    Args:
        options: Options of the stage.

    Returns:
        The stage `forecast`, whose output is `ForecastFans`.
    """
    fitted = ("motion", "fit") if options.profile else ("motion",)  # the fit tells whether the profile can be used
    return Stage("forecast", __name__, ("calibrate", "track", *fitted), ForecastFans, _forecast_moments, options)


def _forecast_moments(inputs: Inputs, options: ForecastOptions, folder: Path, progress: Progress) -> ForecastFans:
    """Predict where balls could have gone, and with a profile compare the rest of the shot; else no forecast."""
    profile = "" if options.profile and inputs["fit"].profile_misfits else options.profile
    if not (options.fans or profile):
        return ForecastFans(())
    from models.estimation.forecast.forecast_check import compare_rest_of_shot  # slow to import
    from models.estimation.forecast.forecast_fans import predict_fans
    from pipeline.io.table_profile import parse_learned_table

    learned = parse_learned_table(profile) if profile else None
    tracks, scene, events = inputs["track"], inputs["calibrate"], inputs["motion"].fit.events
    fans = predict_fans(tracks, scene, events, learned) if options.fans else ForecastFans(())
    return fans if learned is None else replace(fans, errors=compare_rest_of_shot(tracks, scene, events, learned))
