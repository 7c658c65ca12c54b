"""Statistics of a session: level, spread and trend of each number over the shots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.fit_result import ShotNumbers
from models.core.typing import FloatArray
from models.numerics.statistics import estimate_sigma

# Shots from which a slope with an interval is stated: fewer have no interval of 95 % by ranks.
MIN_TREND_SHOTS = 4
# Probability from which the range of some shots is taken to hold the player's true level.
SURE_RANGE = 0.95
# Numbers that a session takes from the object ball alone.
OF_OBJECT_BALL = ("pocket_offset", "pocket_speed")
# Numbers that a session takes from cue ball and object ball, as `length` and `object_length`.
OF_BOTH_BALLS = ("length", "cushions")


@dataclass(frozen=True, slots=True)
class SeriesSummary:
    """Level, spread and trend of one number over K shots in which it is observable, in its unit."""

    name: str
    unit: str
    count: int
    median: float
    spread: float
    """Robust standard deviation over the shots: 1.4826 times the median absolute deviation; NaN below two shots."""
    measurement: float
    """Median standard deviation of a single measurement."""
    own_spread: float
    """Spread without the measurement errors, which add in squares; 0 where these explain it."""
    slope: float
    """Median of the slopes between all pairs of shots (Theil 1950, Sen 1968), per shot; NaN for few shots."""
    slope_low: float
    """Limits of its 95 % interval, by Kendall's rank statistic (Sen 1968)."""
    slope_high: float

    @property
    def has_trend(self) -> bool:
        """Whether the interval of the slope leaves out 0."""
        return bool(self.slope_low > 0 or self.slope_high < 0)


def compute_range_coverage(count: int) -> float:
    """Compute the probability that the true median lies within the range of some independent shots.

    Args:
        count: Number of shots, at least one.

    Returns:
        The probability: that neither all shots lie above the median nor all below it, each with one half.
    """
    return float(1 - 2.0 ** (1 - count))


def collect_session_numbers(shot: ShotNumbers) -> dict[str, tuple[float, float, str, bool]]:
    """Collect the numbers of a shot that a session compares.

    Args:
        shot: Numbers of the shot.

    Returns:
        Value, standard deviation, unit and observability by name. Where there is one for every ball, the cue ball's
        keeps the name, and that of the object ball begins with `object_`.
    """
    numbers: dict[str, tuple[float, float, str, bool]] = {}
    for one in shot.numbers:
        name = one.name
        if (name in OF_OBJECT_BALL and one.ball != shot.first) or (
            name in OF_BOTH_BALLS and one.ball not in (shot.cue, shot.first)
        ):
            continue
        if name in OF_BOTH_BALLS and one.ball == shot.first:
            name = f"object_{name}"
        numbers.setdefault(name, (one.value, one.sigma, one.unit, one.observable))
    return numbers


def summarize_series(name: str, unit: str, x: FloatArray, values: FloatArray, sigmas: FloatArray) -> SeriesSummary:
    """Summarize one number over the shots.

    Args:
        name: Name of the number.
        unit: Its unit.
        x: (K,) number of each shot in the session.
        values: (K,) values; NaN where it is not observable.
        sigmas: (K,) standard deviations.

    Returns:
        The summary.
    """
    rows = np.isfinite(values)
    x, values, sigmas = x[rows], values[rows], sigmas[rows]
    if not len(values):
        return SeriesSummary(name, unit, 0, *(float("nan"),) * 7)
    if name == "direction":  # of 179 and -179 degrees, the middle is 180
        around = np.degrees(np.angle(np.exp(1j * np.radians(values)).sum()))
        values = around + (values - around + 180) % 360 - 180
    middle, measurement = float(np.median(values)), float(np.sqrt(np.median(sigmas**2)))
    spread = estimate_sigma(values) if len(values) > 1 else float("nan")
    own = float(np.sqrt(max(spread**2 - measurement**2, 0.0))) if np.isfinite(spread) else float("nan")
    slope = low = high = float("nan")
    if len(values) >= MIN_TREND_SHOTS:
        from scipy import stats  # slow to import

        fitted = stats.theilslopes(values, x, 0.95)
        slope, low, high = float(fitted.slope), float(fitted.low_slope), float(fitted.high_slope)
    return SeriesSummary(name, unit, len(values), middle, spread, measurement, own, slope, low, high)


def estimate_player_spread(shots: Sequence[ShotNumbers]) -> tuple[float, float]:
    """Estimate how a player's strokes scatter from repetitions of one shot.

    Args:
        shots: Numbers of at least two shots.

    Returns:
        Standard deviation of the speed as a share of it, and of the direction in degrees, without measurement errors.

    Raises:
        ValueError: Fewer than two shots have an observable speed and direction.
    """
    rows = [
        (speed.value, speed.sigma, direction.value, direction.sigma)
        for shot in shots
        if (speed := shot.find_number("cue_speed")) is not None
        and (direction := shot.find_number("direction")) is not None
        and speed.observable
        and direction.observable
    ]
    if len(rows) < 2:
        raise ValueError(f"two shots with an observable speed are needed; got {len(rows)}")
    speed, speed_sigma, direction, direction_sigma = np.array(rows).T
    shots_numbers = np.arange(len(rows), dtype=float)
    fast = summarize_series("cue_speed", "m/s", shots_numbers, speed, speed_sigma)
    aim = summarize_series("direction", "deg", shots_numbers, direction, direction_sigma)
    return fast.own_spread / fast.median, aim.own_spread
