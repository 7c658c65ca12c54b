"""Forecast: what was to be expected at a few moments of the shot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from models.forecast.foresight import Foresights
from models.progress import Progress
from pipeline.stage import Inputs, Stage


@dataclass(frozen=True, slots=True)
class ForecastOptions:
    """There is nothing to choose."""


def forecast_stage() -> Stage:
    return Stage("forecast", __name__, ("calibrate", "track", "fit"), Foresights, _run, ForecastOptions())


def _run(inputs: Inputs, options: ForecastOptions, folder: Path, progress: Progress) -> Foresights:
    from models.forecast.foresee import foresee  # slow to import, and not needed while cached

    return foresee(inputs["track"], inputs["calibrate"], inputs["fit"].events)
