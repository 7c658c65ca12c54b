"""Words for the numbers of a session: level, spread and trend over its shots."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite

from models.core.fit_result import ShotNumber
from models.core.number_format import format_measured, format_unit
from models.estimation.shot_numbers.session_statistics import MIN_TREND_SHOTS, OF_BOTH_BALLS, SeriesSummary
from pipeline.reporting.text.number_sentences import DECIMALS, NUMBER_NAMES, format_direction, format_number

SUMMARY_HEADINGS = ("number", "shots", "median", "own spread", "unit", "trend per shot")
# Instead of the median of directions that lead towards different rails, which none of the shots may have.
MIXED_DIRECTIONS = "of several directions"


def list_summary_cells(one: SeriesSummary, headings: Iterable[str]) -> tuple[str, ...]:
    """List the cells of a number in the table with `SUMMARY_HEADINGS`, for shots with these headings."""
    return (
        name_number(one.name), str(one.count), format_level(one, headings), format_own_spread(one),
        format_unit(one.unit), format_trend(one),
    )  # fmt: skip


def name_number(name: str) -> str:
    """Return the words for a number of a session, such as `object_length`; which ball, where both have one."""
    words = NUMBER_NAMES.get(name) or NUMBER_NAMES[name.removeprefix("object_")]
    if name.removeprefix("object_") in OF_BOTH_BALLS:
        return f"{words} {'of the object ball' if name.startswith('object_') else 'of the cue ball'}"
    return words


def format_level(one: SeriesSummary, headings: Iterable[str] = ()) -> str:
    """Format the median of a number over the shots as a number of one shot, with the digits of its measurement.

    Args:
        one: The summary.
        headings: Words for the headings of the shots, from `name_heading`.
    """
    median = ShotNumber(one.name, one.median, one.measurement, one.unit, True)
    if one.name == "direction":
        common = {*headings} - {""}
        return format_direction(median, common.pop(), has_sigma=False) if len(common) == 1 else MIXED_DIRECTIONS
    return format_number(median, has_sigma=False)


def format_trend(one: SeriesSummary) -> str:
    """Format the slope of a number over the shots with its interval; how many shots it needs where there are fewer."""
    if not isfinite(one.slope):
        return f"needs {MIN_TREND_SHOTS} shots"
    half = (one.slope_high - one.slope_low) / 2
    slope, low, high = (
        format_measured(value, half, DECIMALS[one.unit] + 1)[0] for value in (one.slope, one.slope_low, one.slope_high)
    )
    return f"{slope} ({low} to {high})"


def format_spread(one: SeriesSummary) -> str:
    """Format the spread over the shots with the digits of the measurement; empty below two shots."""
    return format_measured(one.spread, one.measurement, DECIMALS[one.unit])[0] if isfinite(one.spread) else ""


def format_own_spread(one: SeriesSummary) -> str:
    """Format the spread without the measurement errors; where these explain it, only their size as a limit."""
    if one.own_spread > 0:
        return format_measured(one.own_spread, one.measurement, DECIMALS[one.unit])[0]
    return f"below {format_measurement(one)}" if isfinite(one.own_spread) and one.measurement > 0 else ""


def format_measurement(one: SeriesSummary) -> str:
    """Format the standard deviation of a number in one shot, as its report does."""
    return format_measured(one.median, one.measurement, DECIMALS[one.unit])[1]
