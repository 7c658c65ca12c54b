"""Presentation times: container timestamps to seconds and a nominal frame rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

# Frame rates of cameras and broadcasters, 1/s.
STANDARD_FPS = (
    *(Fraction(r) for r in (10, 12, 15, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)),
    *(Fraction(r * 1000, 1001) for r in (15, 24, 30, 60, 120, 240)),
    Fraction(25, 2),
)

# Relative distance within which a measured frame rate counts as a standard one (the clock of a phone is better). Of
# rates a tenth of a per cent apart, such as 29.97 and 30, the nearest is taken.
FPS_TOLERANCE = 0.0025


# Ratio of capture rate and stored rate from which a file is slow motion, and below the inverse of which it is a time
# lapse. Cameras slow down twice at least; one that drops frames in poor light stores fewer than the rate it was set to.
LEAST_SLOW_MOTION = 1.5


def is_slow_motion(stored: Fraction, capture: Fraction) -> bool:
    """Check whether a file plays at another speed than it was filmed at, from both rates, 1/s."""
    return not 1 / LEAST_SLOW_MOTION < capture / stored < LEAST_SLOW_MOTION


def compute_presentation_times(
    pts: Sequence[int | None], dts: Sequence[int | None], time_base: Fraction, fps: Fraction
) -> tuple[FloatArray, str]:
    """Convert timestamps of the container to seconds.

    Containers that only number their packets (AVI) have correct times in `dts`. A frame without a timestamp, or with
    one that does not increase, is placed evenly between its neighbours; where most are missing, all frames are 1 / fps
    apart.

    Args:
        pts: (T,) presentation timestamps in units of `time_base`; None where missing.
        dts: (T,) decoding timestamps in the same units.
        time_base: duration of one unit, s.
        fps: frame rate (1/s) for files without usable timestamps.

    Returns:
        (T,) s, strictly increasing, the first 0; and a sentence that reports repaired times, or an empty one.
    """
    ticks = max(_relative_ticks(pts), _relative_ticks(dts), key=lambda each: np.count_nonzero(_is_increasing(each)))
    usable = _is_increasing(ticks)
    if np.count_nonzero(usable) < max(2, 0.5 * len(ticks)):
        return even_times(len(ticks), fps), f"it has no usable timestamps; {float(fps):.5g} fps are assumed"
    seconds = ticks * time_base.numerator / time_base.denominator
    missing = int(np.count_nonzero(~usable))
    if missing == 0:
        return seconds, ""
    filled = _interpolate_unusable(seconds, usable)
    return filled - filled[
        0
    ], f"{missing} of {len(ticks)} frames have no usable timestamp and were placed between their neighbours"


# Frames below which a line through the timestamps follows their jitter.
MIN_FRAMES = 20
# Frame intervals, root mean square deviation of timestamps from even ones that counts: clocks of a millisecond round to
# 0.017 of the interval at 60 fps.
LEAST_JITTER = 0.02
# Frame intervals: a timestamp that is further off is not late; frames are missing or held there.
MOST_JITTER = 1.0
# Correlation of successive deviations: three standard deviations of that of 100 independent ones. That of a camera
# whose rate really changes is nearly 1.
MOST_CORRELATION = 0.3


def find_jitter(t: FloatArray) -> tuple[FloatArray, float]:
    """Find even times where timestamps jitter about them, as some writers stamp frames when they receive them.

    Args:
        t: (T,) s, presentation times.

    Returns:
        (T,) s, even times, and the root mean square deviation from them, s; the same times and 0 without jitter.
    """
    order = np.arange(len(t), dtype=np.float64)
    if len(t) < MIN_FRAMES:
        return t, 0.0
    interval, start = (float(each) for each in np.polyfit(order, t, 1))
    off = t - start - interval * order
    jitter = float(np.sqrt(np.mean(off**2)))
    if jitter < LEAST_JITTER * interval or float(np.abs(off).max()) > MOST_JITTER * interval:
        return t, 0.0
    correlation = float(off[1:] @ off[:-1]) / (len(off) * jitter**2)
    return (interval * order, jitter) if correlation < MOST_CORRELATION else (t, 0.0)


@dataclass(frozen=True, slots=True)
class CameraClock:
    """When a camera took the T frames of a file."""

    t: FloatArray
    """(T,) s."""
    fps: Fraction
    """Nominal frame rate, 1/s."""
    rate: float
    """Seconds of `t` per second of the presentation times: below 1 for slow motion, 0 where even times replaced them.
    """
    jitter: float
    """s, root mean square deviation of presentation times that jitter; else 0."""


def find_camera_clock(t: FloatArray, declared: Fraction | None, capture: Fraction | None) -> CameraClock:
    """Find when the camera took frames, from their presentation times.

    Args:
        t: (T,) s, presentation times.
        declared: frame rate in the header, 1/s.
        capture: rate at which the camera took frames, 1/s, if the file states one.

    Returns:
        The clock.
    """
    stored = nominal_fps(t, declared)
    if capture and is_slow_motion(stored, capture):
        rate = float(stored / capture)
        return CameraClock(t * rate, capture, rate, 0.0)
    even, jitter = find_jitter(t)
    return CameraClock(even, nominal_fps(even, declared), 0.0, jitter) if jitter else CameraClock(t, stored, 1.0, 0.0)


def even_times(count: int, fps: Fraction) -> FloatArray:
    """Return (count,) s with frame k at exactly k / fps."""
    return np.arange(count, dtype=np.float64) * fps.denominator / fps.numerator


def nominal_fps(t: FloatArray, declared: Fraction | None) -> Fraction:
    """Determine the nominal frame rate from presentation times.

    Args:
        t: (T,) s, presentation times.
        declared: frame rate in the header, 1/s.

    Returns:
        The declared rate where the times confirm it, else the nearest standard rate, else the measured one (1/s).
    """
    measured = _measure_fps(t)
    if declared and declared.denominator <= 1001 and abs(float(declared) / measured - 1) < 1e-4:
        return declared
    nearest = min(STANDARD_FPS, key=lambda standard: abs(float(standard) - measured))
    if abs(float(nearest) / measured - 1) < FPS_TOLERANCE:
        return nearest
    return Fraction(measured).limit_denominator(1001)


def _measure_fps(t: FloatArray) -> float:
    """Measure the frame rate (1/s) over steps of ordinary length; gaps and millisecond rounding are left out."""
    steps = np.diff(t)
    middle = np.sort(steps)[len(steps) // 2]  # one of them: between two very different ones there is none
    return float(1 / np.mean(steps[np.abs(steps - middle) <= 0.25 * middle]))


def _relative_ticks(stamps: Sequence[int | None]) -> FloatArray:
    """Return (T,) ticks since the first timestamp; NaN where there is none."""
    first = next((s for s in stamps if s is not None), 0)
    return np.array([np.nan if s is None else s - first for s in stamps], dtype=np.float64)


def _is_increasing(ticks: FloatArray) -> NDArray[np.bool_]:
    """Mark (T,) the timestamps that exist and are later than all before them."""
    usable_stamps = np.where(np.isnan(ticks), -np.inf, ticks)
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], usable_stamps[:-1]]))
    return np.asarray(usable_stamps > latest)


def _interpolate_unusable(seconds: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Replace unusable times by even steps between, before the first and after the last usable one."""
    places, usable_s = np.flatnonzero(usable), seconds[usable]
    step = float(np.median(np.diff(usable_s) / np.diff(places)))
    index = np.arange(len(seconds))
    inside = np.interp(index, places, usable_s)
    before = usable_s[0] + (index - places[0]) * step
    after = usable_s[-1] + (index - places[-1]) * step
    return np.where(index < places[0], before, np.where(index > places[-1], after, inside))
