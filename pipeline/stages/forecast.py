"""Forecast: what was to be expected at a few moments of the shot."""

from __future__ import annotations

from pathlib import Path

from models.forecast.foresight import Foresights
from models.options import ForecastOptions
from models.progress import Progress
from pipeline.stage import Inputs, Stage


def forecast_stage(options: ForecastOptions) -> Stage:
    return Stage("forecast", __name__, ("calibrate", "track", "fit"), Foresights, _run, options)


def _run(inputs: Inputs, options: ForecastOptions, folder: Path, progress: Progress) -> Foresights:
    if not options.fans:
        return Foresights(())
    from models.forecast.foresee import foresee  # slow to import, and not needed while cached

    return foresee(inputs["track"], inputs["calibrate"], inputs["fit"].events)
