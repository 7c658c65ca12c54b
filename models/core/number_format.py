"""Text for measured values with their standard deviations, and for probabilities: the same digits everywhere."""

from __future__ import annotations

import re
from math import floor, isfinite, log10, nan

import numpy as np

# Decimals of a number at most: no value of a clip is known better, in any unit that is printed.
MAX_DECIMALS = 9
# Decimals of a time in s at most: no contact is timed to better than 0.1 ms.
TIME_DECIMALS = 4
# s: from here on, the error of a time is written in s as the time is.
LONG_ERROR = 0.1
# Decimals of a speed in m/s.
SPEED_DECIMALS = 2
# Speed, m/s, below which a decimal of km/h would say less than those of m/s: 0.04 m/s is both 0.1 and 0.2 km/h.
CREEPING_SPEED = 0.1
# First digits of a standard deviation below which it has two significant digits, else one (rounding rule of the
# Particle Data Group, Phys. Rev. D 110, 030001, 2024, introduction, section 5.3).
TWO_DIGITS_BELOW = 3.55
# Probability from 0 and from 1 within which only the limit is written: no model is surer of itself.
EXTREME_PROBABILITY = 0.001
# Probability from 0 and from 1 from which whole per cents suffice.
MIN_WHOLE_SHARE = 0.01


def format_measured(value: float, sigma: float, max_decimals: int = MAX_DECIMALS) -> tuple[str, str]:
    """Format a value and its standard deviation with the same decimals, those that the standard deviation determines.

    Args:
        sigma: Its standard deviation; 0, NaN or infinite if it is unknown.
        max_decimals: Decimals at most, for numbers whose readers need no more.

    Returns:
        Two texts without exponents. A value that rounds to zero is `0`; an unknown standard deviation is empty, one
        below the last decimal is one unit of it.
    """
    if not (isfinite(sigma) and sigma > 0):
        return format_value(value), ""
    order = floor(log10(sigma))
    decimals = min((1 if sigma / 10.0**order < TWO_DIGITS_BELOW else 0) - order, max_decimals)
    shown_sigma = max(round(sigma, decimals), 10.0**-decimals)
    shown = round(value, decimals)
    places = max(decimals, 0)
    return "0" if shown == 0 else f"{shown:.{places}f}", f"{shown_sigma:.{places}f}"


def format_with_sigma(value: float, sigma: float, max_decimals: int = MAX_DECIMALS) -> str:
    """Format a value and its standard deviation.

    Args:
        sigma: Its standard deviation; NaN where it is unknown.
        max_decimals: Largest number of decimals.

    Returns:
        `value ± sigma`, or the value alone where that is unknown.
    """
    return " ± ".join(filter(None, format_measured(value, sigma, max_decimals)))


def format_value(value: float, digits: int = 3) -> str:
    """Format a number without a known standard deviation, without an exponent.

    Args:
        value: The number.
        digits: Significant digits.

    Returns:
        The number without trailing zeros; empty if it is not finite.
    """
    if not isfinite(value):
        return ""
    if abs(value) < 10.0**-MAX_DECIMALS:
        return "0"
    return np.format_float_positional(value, precision=digits, unique=False, fractional=False, trim="-")


def format_speed(speed: float, sigma: float = nan) -> str:
    """Format a speed.

    Args:
        speed: In m/s.
        sigma: Its standard deviation; NaN if it is unknown.

    Returns:
        Such as `1.80 m/s (6.5 km/h)`, with the standard deviation if it is known; a creeping ball has m/s alone.
    """
    shown = format_with_sigma(speed, sigma, SPEED_DECIMALS) if sigma > 0 else f"{speed:.{SPEED_DECIMALS}f}"
    return f"{shown} m/s ({3.6 * speed:.1f} km/h)" if speed >= CREEPING_SPEED else f"{shown} m/s"


def format_flight_speed(speed: float, sigma: float = nan) -> str:
    """Format the speed, m/s, of a ball or shuttle in flight, such as `213 ± 11 km/h`: players state it so."""
    return f"{format_with_sigma(3.6 * speed, 3.6 * sigma, 1)} km/h"


def format_time(t: float, sigma: float = nan) -> str:
    """Format an estimated time of the clip.

    Args:
        t: s.
        sigma: Its standard deviation, s; NaN where it is unknown.

    Returns:
        Such as `0.7012 s ± 0.3 ms`, `4.12 s ± 0.20 s`, or `about 0.7 s` without a standard deviation.
    """
    if not isfinite(sigma):
        return f"about {t:.1f} s"
    shown, error = format_measured(t, max(sigma, 10.0**-TIME_DECIMALS), TIME_DECIMALS)
    in_ms = f"{1000 * float(error):.{max(len(error.partition('.')[2]) - 3, 0)}f} ms"
    return f"{shown} s ± {in_ms if float(error) < LONG_ERROR else f'{error} s'}"


def format_moment(t: float) -> str:
    """Format a time of the clip that has no error: of a frame, of the end of the clip, or one that somebody chose."""
    return f"{t:.3f} s"


def format_probability(probability: float) -> str:
    """Format a probability in per cent, with a decimal near 0 and 1.

    Args:
        probability: From 0 to 1.

    Returns:
        Such as `61 %`, `99.8 %` or `above 99.9 %`.
    """
    if probability < EXTREME_PROBABILITY:
        return "below 0.1 %"
    if probability > 1 - EXTREME_PROBABILITY:
        return "above 99.9 %"
    is_middling = MIN_WHOLE_SHARE <= probability <= 1 - MIN_WHOLE_SHARE
    return f"{100 * probability:.{0 if is_middling else 1}f} %"


def format_doubt(probability: float) -> str:
    """Format a probability in brackets.

    Args:
        probability: Of what stands before it.

    Returns:
        Such as ` (93 %)`; empty where it is as good as certain.
    """
    return "" if probability > 1 - EXTREME_PROBABILITY else f" ({format_probability(probability)})"


def format_unit(unit: str) -> str:
    """Format a unit with its signs, such as rad/s² for `rad/s2` and ° for `deg`; nothing for a dimensionless number."""
    squares = re.sub(r"(?<=[a-z)])2\b", "²", unit)
    return {"1": "", "deg": "°"}.get(unit, squares)
