"""Values have the digits that their standard deviations determine; probabilities never claim certainty."""

from __future__ import annotations

import pytest

from models.core.fit_result import ShotNumber
from models.core.number_format import (
    format_measured,
    format_probability,
    format_speed,
    format_time,
    format_value,
    format_with_sigma,
)
from pipeline.reporting.text.number_sentences import format_number


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (-4.174e-232, 0.004, ("0", "0.004")),
        (-0.0003, 0.004, ("0", "0.004")),
        (0.008952, 0.00078, ("0.0090", "0.0008")),
        (0.009061, 3.1e-05, ("0.009061", "0.000031")),
        (9.8e-05, 7e-06, ("0.000098", "0.000007")),
        (1.0, 0.0999, ("1.00", "0.10")),
        (12345.0, 678.0, ("12300", "700")),
        (1.5, 0.0, ("1.5", "")),
        (1.5, float("nan"), ("1.5", "")),
    ],
)
def test_the_standard_deviation_determines_the_digits(value: float, sigma: float, expected: tuple[str, str]) -> None:
    assert format_measured(value, sigma) == expected


@pytest.mark.parametrize(
    ("sigma", "text"),
    [(0.0, "4.1235 s ± 0.1 ms"), (6.2e-4, "4.1235 s ± 0.6 ms"), (0.0123, "4.123 s ± 12 ms"),
     (0.0697, "4.12 s ± 70 ms"), (0.12, "4.12 s ± 0.12 s"), (float("nan"), "about 4.1 s")],
)  # fmt: skip
def test_a_time_has_the_digits_that_its_error_allows(sigma: float, text: str) -> None:
    assert format_time(4.123456, sigma) == text


def test_a_creeping_ball_has_no_pace_in_kilometres_an_hour() -> None:
    assert format_speed(0.0420) == format_speed(0.0385) == "0.04 m/s"
    assert format_speed(2.2937) == "2.29 m/s (8.3 km/h)"


def test_a_standard_deviation_below_the_last_decimal_is_one_unit_of_it() -> None:
    assert format_with_sigma(2.1702, 0.0031, 2) == "2.17 ± 0.01"
    assert format_with_sigma(0.001, 0.0001, 2) == "0 ± 0.01"


@pytest.mark.parametrize(
    ("value", "text"), [(9.8e-05, "0.000098"), (3.9e-06, "0.0000039"), (-46.12, "-46.1"), (0.0, "0"), (1e-15, "0")]
)
def test_a_number_has_no_exponent(value: float, text: str) -> None:
    assert format_value(value) == text


@pytest.mark.parametrize(
    ("probability", "text"),
    [(0.0, "below 0.1 %"), (0.0012, "0.1 %"), (0.61, "61 %"), (0.998, "99.8 %"), (0.9991, "above 99.9 %"),
     (1.0, "above 99.9 %")],
)  # fmt: skip
def test_no_probability_is_printed_as_certain(probability: float, text: str) -> None:
    assert format_probability(probability) == text


def test_a_number_without_a_side_has_no_word_for_it() -> None:
    assert format_number(ShotNumber("throw", 0.001, 0.1, "deg", True)) == "may be zero (0 ± 0.1°)"
    assert format_number(ShotNumber("throw", -0.84, 0.1, "deg", True)) == "0.8 ± 0.1° left"
