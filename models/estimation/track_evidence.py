"""Evidence in tracks of unknown origin: repeated samples, direction and unit of a fall, unit and origin of angles.

Everything here is measured on paths alone; what follows from it is decided where tracks are read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from models.core.typing import BoolArray, FloatArray

# Times (T,) s, increasing, and coordinates (T, D) of one body.
BodyPath = tuple[FloatArray, FloatArray]

# Share of the values of a moving body that are repeated, from which a recorder held them: a 25 Hz camera in a 30 Hz
# file repeats a fifth, and chance repeats all coordinates of a moving body in less than a hundredth of the samples.
_MIN_HELD_SHARE = 0.1
# Fewest values of a moving body that such a share is measured on.
_MIN_VALUES = 8
# Change per step, in units of the last digit, from which a repeated value is no effect of rounding, which repeats
# values where a body moves less than one unit per step.
_MOVING_QUANTA = 2.0
# Values before and after one between which a body moves on, and the share of its path that it then gets ahead: one that
# moves gets nearly all of it ahead, the noise of one at rest about a quarter.
_NEAR_VALUES, _MIN_AHEAD = 2, 0.6
# Difference of two steps, in the largest step, that is an effect of the arithmetic.
_ROUNDING = 1e-9
# Largest difference of a rounded time from its even one, in units of the clock: half, and the error of the fit.
_MAX_ROUNDING = 0.6
# Largest difference of a time from its even one, in steps, that does not matter: a body moves a hundredth of its path
# per frame.
_LEAST_ROUNDING = 0.01
# Step, in units of the clock, from which on to its inverse missing samples look like rounding.
_LIKE_CLOCK = 0.8
# Correlation with the rate of a coordinate from which a column is this rate: another coordinate's has less unless both
# move along one line, where their ratio is not that of two units.
_MIN_CORRELATION = 0.98
# Fewest samples of a fitted parabola: three are free.
_WINDOW_SAMPLES = 7
# Length of a fitted parabola, in lengths of the path: shorter ones measure noise, longer ones average over drag.
_WINDOW_SHARE = 0.25
# Standard errors from which an acceleration is a fact: drag and wind are modelled roughly.
SURE_SIGMAS = 5.0
# Samples of the parabolas that give derivatives of angles; the best one counts, as noise and rate are not known.
_SMOOTHING = (5, 9, 17, 33)
# Step from which an angle was wrapped, in periods: half a period per sample could be either direction.
_MIN_JUMP = 0.6


@dataclass(frozen=True, slots=True)
class Fall:
    """Acceleration of bodies at rest in the air, extrapolated over their drag."""

    acceleration: float
    """Unit of the coordinate per s^2."""
    sigma: float
    has_drag: bool = False
    """Whether it holds their drag too, as they never were slow enough to tell it apart."""


def find_held_samples(positions: FloatArray) -> BoolArray:
    """Find the samples of a body that a recorder repeated because no new one had come.

    Args:
        positions: (T, D) of one body, in the order of time.

    Returns:
        (T,) mask of repetitions; none where the body repeats by rounding or by rest alone, whose values may still be
        noisy. At rest every sample repeats, and as many are kept as while the body moves.
    """
    is_repetition = np.zeros(len(positions), bool)
    steps = np.abs(np.diff(positions, axis=0))
    starts = np.flatnonzero(np.append(True, steps.any(axis=1)))
    lengths = np.diff(np.append(starts, len(positions)))
    if len(starts) <= _MIN_VALUES or lengths.max() == 1:
        return is_repetition
    quantum = np.array([_measure_quantum(column) for column in steps.T])
    across = np.abs(positions[starts[2:]] - positions[starts[1:-1] - 1])
    is_moving = (across > _MOVING_QUANTA * quantum * (lengths[1:-1, None] + 1)).any(axis=1)
    moving = lengths[1:-1][is_moving & _gets_ahead(positions[starts])[1:-1]]
    if len(moving) < _MIN_VALUES or (moving > 1).mean() < _MIN_HELD_SHARE:
        return is_repetition
    longest = int(np.quantile(moving, 0.95))
    return np.asarray((np.arange(len(positions)) - np.repeat(starts, lengths)) % longest > 0)


def _gets_ahead(values: FloatArray) -> BoolArray:
    """Return which values (R, D), in the order of time, are of a body that moves on, not of one that jitters."""
    number = np.arange(len(values))
    first, last = np.maximum(number - _NEAR_VALUES, 0), np.minimum(number + _NEAR_VALUES, len(values) - 1)
    length = np.append(0.0, np.linalg.norm(np.diff(values, axis=0), axis=1).cumsum())
    ahead = np.linalg.norm(values[last] - values[first], axis=1)
    return np.asarray(ahead > _MIN_AHEAD * (length[last] - length[first]))


def _measure_quantum(steps: FloatArray) -> float:
    """Measure the unit of the last digit of values by their steps (T,), whose differences it divides."""
    gaps = np.diff(np.unique(np.append(0.0, steps)))
    return float(gaps[gaps > _ROUNDING * steps.max(initial=0.0)].min(initial=np.inf))


def fit_even_times(number: FloatArray, t: FloatArray) -> tuple[FloatArray, float] | None:
    """Fit even times to times that a coarse clock rounded.

    Args:
        number: (K,) number of each sample.
        t: (K,) s.

    Returns:
        (K,) s, the even times, and the unit of the clock, s; None where rounding does not explain the differences, or
        they do not matter.
    """
    steps = np.diff(np.unique(t))
    if len(np.unique(number)) < _MIN_VALUES or not len(steps):
        return None
    clock, count = _measure_quantum(steps), number - number.mean()
    step = float(count @ t / (count @ count))
    even = t.mean() + step * count
    is_rounded = _LEAST_ROUNDING * step < float(np.abs(t - even).max()) < _MAX_ROUNDING * clock
    return (even, clock) if is_rounded and not _LIKE_CLOCK < step / clock < 1 / _LIKE_CLOCK else None


def measure_rate_ratio(samples: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> float | None:
    """Measure the ratio of the rate of a coordinate and another column, if that is its rate up to a factor.

    Args:
        samples: Times, coordinate and column (T,) of every body in every shot.

    Returns:
        The ratio; None where they do not change alike.
    """
    best, ratio = _MIN_CORRELATION, None
    if not all(np.isfinite(column).all() for _, _, column in samples):
        return None
    totals = [np.append(0.0, np.cumsum(np.diff(t) * (column[1:] + column[:-1]) / 2)) for t, _, column in samples]
    for lag in _SMOOTHING:
        moved = np.concatenate([x[lag:] - x[:-lag] for _, x, _ in samples])
        summed = np.concatenate([total[lag:] - total[:-lag] for total in totals])
        if len(moved) >= _MIN_VALUES and np.ptp(moved) > 0 and np.ptp(summed) > 0:
            alike = abs(float(np.corrcoef(moved, summed)[0, 1]))
            if alike > best:
                best, ratio = alike, float(moved @ summed / (summed @ summed))
    return ratio


def measure_fall(paths: Sequence[BodyPath], column: int) -> Fall | None:
    """Measure how bodies in the air accelerate along one coordinate.

    Parabolas through parts of the paths give accelerations; those are extrapolated to rest, as drag grows with the
    square of speed.

    Args:
        paths: Path of every body in every shot.
        column: Number of the coordinate.

    Returns:
        The acceleration; None where the paths are too short.
    """
    samples = []
    for t, positions in paths:
        count = max(_WINDOW_SAMPLES, int(_WINDOW_SHARE * len(t)))
        for first in range(0, len(t) - count + 1, max(count // 2, 1)):
            part = slice(first, first + count)
            clock = t[part] - t[part].mean()
            half, speed, _ = np.polyfit(clock, positions[part, column], 2)
            samples.append((2 * half, speed * abs(speed), np.ptp(clock) ** 2))
    if len(samples) < 2:
        return None
    acceleration, drag, weight = np.array(samples).T
    basis = np.stack([np.ones(len(drag)), drag / max(np.abs(drag).max(), 1e-300)], axis=1)
    if len(samples) < 4 or np.ptp(basis[:, 1]) < _WINDOW_SHARE:
        basis = basis[:, :1]
    falls = [_fit_acceleration(acceleration, basis[:, :count], weight) for count in range(basis.shape[1], 0, -1)]
    return next((fall for fall in falls if abs(fall.acceleration) > SURE_SIGMAS * fall.sigma), falls[0])


def _fit_acceleration(acceleration: FloatArray, basis: FloatArray, weight: FloatArray) -> Fall:
    """Fit accelerations (M,) by a constant and, in a second column of the basis, drag."""
    scaled = basis * weight[:, None]
    value = np.linalg.lstsq(scaled, acceleration * weight, rcond=None)[0]
    spread = np.square(acceleration * weight - scaled @ value).sum() / max(len(weight) - basis.shape[1], 1)
    sigma = float(np.sqrt(spread * np.linalg.pinv(scaled.T @ scaled)[0, 0]))
    return Fall(float(value[0]), sigma, basis.shape[1] == 1)


def unwrap_angles(angles: FloatArray, turn: float) -> FloatArray | None:
    """Unwrap angles that a sensor keeps within a range of one turn or half a turn.

    Args:
        angles: (T, D), in the order of time.
        turn: One turn in their unit.

    Returns:
        (T, D) without jumps, beginning within half a turn of 0; None where no coordinate was wrapped.
    """
    unwrapped, is_wrapped = angles.copy(), False
    for column in range(angles.shape[1]):
        values = angles[:, column]
        jumps = np.abs(np.diff(values)).max(initial=0.0)
        for period in (turn / 2, turn):
            if _MIN_JUMP * period < jumps and np.ptp(values) <= 1.01 * period:
                smooth = np.unwrap(values, period=period)
                unwrapped[:, column] = smooth - turn * np.round(smooth[0] / turn)
                is_wrapped = True
                break
    return unwrapped if is_wrapped else None


@dataclass(frozen=True, slots=True)
class SwingFit:
    """How well angles move as a pendulum of one or two arms does."""

    misfit: float
    """rms of the accelerations that the equation of motion leaves, relative to their own; 1 where nothing fits."""
    rest: FloatArray
    """(D,) angle at which each arm hangs, rad."""


def fit_swing(paths: Sequence[BodyPath]) -> SwingFit:
    """Fit the equation of motion of a pendulum, whose unknown coefficients enter linearly, to accelerations of angles.

    Args:
        paths: Angles (T, D) of one or two arms in rad, for every body in every shot.

    Returns:
        The fit with the least misfit of those to differently smoothed accelerations.
    """
    count = paths[0][1].shape[1] if paths else 1
    fits = [SwingFit(1.0, np.zeros(count))]
    for size in _SMOOTHING:
        parts = [_differentiate(t, angles, size) for t, angles in paths if len(t) >= 2 * size]
        if parts:
            angle, rate, change = (np.concatenate([part[k] for part in parts]) for k in range(3))
            fits.append(_fit_equation_of_motion(angle, rate, change))
    return min(fits, key=lambda fit: fit.misfit)


def _differentiate(t: FloatArray, angles: FloatArray, size: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return angles, rates and accelerations (M, D) at the centres of parabolas through `size` samples."""
    step = max(size // 2, 1)
    clocks, values = sliding_window_view(t, size)[::step], sliding_window_view(angles, size, axis=0)[::step]
    clocks = clocks - clocks.mean(axis=1, keepdims=True)
    inverse = np.linalg.pinv(clocks[:, :, None] ** np.arange(3))
    value, rate, half = np.einsum("mks,mds->kmd", inverse, values)
    return value, rate, 2 * half


def _fit_equation_of_motion(angle: FloatArray, rate: FloatArray, change: FloatArray) -> SwingFit:
    """Fit the accelerations (M, D) of angles: gravity, friction, and the reaction of the other arm (Lagrange)."""
    left, rests = [], []
    for arm in range(angle.shape[1]):
        terms = [np.sin(angle[:, arm]), np.cos(angle[:, arm]), rate[:, arm]]
        if angle.shape[1] == 2:
            other = 1 - arm
            apart = angle[:, arm] - angle[:, other]
            terms += [np.cos(apart) * change[:, other], np.sin(apart) * rate[:, other] ** 2, rate[:, other]]
        basis = np.stack(terms, axis=1)
        value = np.linalg.lstsq(basis, change[:, arm], rcond=None)[0]
        total = np.sqrt(np.mean(np.square(change[:, arm])))
        left.append(np.sqrt(np.mean(np.square(change[:, arm] - basis @ value))) / total if total > 0 else 1.0)
        rests.append(np.arctan2(value[1], -value[0]))
    return SwingFit(float(np.mean(left)), np.array(rests))


def measure_speed(paths: Sequence[BodyPath]) -> float:
    """Measure the speed of bodies; the 90th percentile, which outliers do not reach.

    Args:
        paths: Path of every body in every shot.

    Returns:
        The speed, in the unit of the coordinates per s; 0 where nothing can be measured.
    """
    speeds = [
        float(np.linalg.norm(positions[b] - positions[a]) / (t[b] - t[a]))
        for t, positions in paths
        for a, b in pairwise(range(0, len(t), 4))
    ]
    return float(np.quantile(speeds, 0.9)) if speeds else 0.0
