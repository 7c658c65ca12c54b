"""Forecast: what was to be expected at a few moments of the shot."""

from __future__ import annotations

from pathlib import Path

from models.core.options import ForecastOptions
from models.core.progress import Progress
from models.estimation.forecast.forecast_values import Foresights
from pipeline.engine.stage import Inputs, Stage


def forecast_stage(options: ForecastOptions) -> Stage:
    return Stage("forecast", __name__, ("calibrate", "track", "fit"), Foresights, _run, options)


def _run(inputs: Inputs, options: ForecastOptions, folder: Path, progress: Progress) -> Foresights:
    if not options.fans:
        return Foresights(())
    from models.estimation.forecast.forecast_fans import foresee  # slow to import, and not needed while cached

    return foresee(inputs["track"], inputs["calibrate"], inputs["fit"].events)
