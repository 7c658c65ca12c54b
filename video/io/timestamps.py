"""When each picture is shown: from the container's presentation timestamps to seconds and a nominal rate."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

STANDARD_RATES = (
    *(Fraction(r) for r in (10, 12, 15, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)),
    *(Fraction(r * 1000, 1001) for r in (15, 24, 30, 60, 120, 240)),
    Fraction(25, 2),
)
"""Pictures per second that cameras and broadcasters use."""

SNAP = 0.0025
"""Relative distance within which a measured rate is taken for a standard one (a phone's clock is better than this).
Rates a tenth of a per cent apart, such as 29.97 and 30, are told apart by taking the nearest."""


def presentation_times(
    pts: Sequence[int | None], dts: Sequence[int | None], time_base: Fraction, rate: Fraction
) -> tuple[FloatArray, str]:
    """Seconds of each picture (F,), the first at 0, strictly increasing, and a sentence where they had to be invented.

    A container that only numbers its packets (AVI) has them right in `dts`. A picture without a timestamp, or with one
    that does not go forward, is placed evenly between its neighbours; where most have none, all are `rate` (1/s) apart.
    """
    ticks = max(_ticks(pts), _ticks(dts), key=lambda each: np.count_nonzero(_forward(each)))
    usable = _forward(ticks)
    if np.count_nonzero(usable) < max(2, 0.5 * len(ticks)):
        return even_times(
            len(ticks), rate
        ), f"it has no usable timestamps; {float(rate):.5g} pictures per second are assumed"
    seconds = ticks * time_base.numerator / time_base.denominator
    missing = int(np.count_nonzero(~usable))
    if missing == 0:
        return seconds, ""
    filled = _filled(seconds, usable)
    return filled - filled[
        0
    ], f"{missing} of {len(ticks)} pictures have no usable timestamp and were placed between their neighbours"


def even_times(count: int, rate: Fraction) -> FloatArray:
    """(count,) s: picture k at exactly k / rate."""
    return np.arange(count, dtype=np.float64) * rate.denominator / rate.numerator


def nominal_rate(t: FloatArray, declared: Fraction | None) -> Fraction:
    """Pictures per second: the declared rate where the times (F,) bear it out, otherwise the next standard one."""
    measured = _measured_rate(t)
    if declared and declared.denominator <= 1001 and abs(float(declared) / measured - 1) < 1e-4:
        return declared
    nearest = min(STANDARD_RATES, key=lambda standard: abs(float(standard) - measured))
    if abs(float(nearest) / measured - 1) < SNAP:
        return nearest
    return Fraction(measured).limit_denominator(1001)


def _measured_rate(t: FloatArray) -> float:
    """Pictures per second over the steps of ordinary length; gaps and millisecond rounding do not count."""
    steps = np.diff(t)
    middle = np.sort(steps)[len(steps) // 2]  # one of them: between two very different ones there is none
    return float(1 / np.mean(steps[np.abs(steps - middle) <= 0.25 * middle]))


def _ticks(stamps: Sequence[int | None]) -> FloatArray:
    """(F,) from the first known stamp on; NaN where there is none."""
    first = next((s for s in stamps if s is not None), 0)
    return np.array([np.nan if s is None else s - first for s in stamps], dtype=np.float64)


def _forward(ticks: FloatArray) -> NDArray[np.bool_]:
    """(F,) True where a timestamp is there and later than all before it."""
    known = np.where(np.isnan(ticks), -np.inf, ticks)
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], known[:-1]]))
    return np.asarray(known > latest)


def _filled(seconds: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Times with the unusable ones put evenly between, before the first and after the last usable one."""
    places, known = np.flatnonzero(usable), seconds[usable]
    step = float(np.median(np.diff(known) / np.diff(places)))
    index = np.arange(len(seconds))
    inside = np.interp(index, places, known)
    before = known[0] + (index - places[0]) * step
    after = known[-1] + (index - places[-1]) * step
    return np.where(index < places[0], before, np.where(index > places[-1], after, inside))
