"""Level, spread and trend of a session."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.fit_result import ShotNumber, ShotNumbers
from models.estimation.shot_numbers.session_statistics import (
    collect_session_numbers,
    compute_range_coverage,
    estimate_player_spread,
    summarize_series,
)


def make_shot(speed: float, direction: float, sigma: float = 0.01) -> ShotNumbers:
    numbers = (
        ShotNumber("cue_speed", speed, sigma, "m/s", True, "cue"),
        ShotNumber("direction", direction, 0.05, "deg", True, "cue"),
        ShotNumber("length", 3.0, 0.01, "m", True, "cue"),
        ShotNumber("length", 1.0, 0.01, "m", True, "red"),
        ShotNumber("length", 9.0, 0.01, "m", True, "blue"),
    )
    return ShotNumbers(0.2, "cue", "red", "stun", (0.0, 1.0, 0.0, 0.0), (), (), numbers)


def test_a_trend_is_found_among_outliers_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(0)
    x = np.arange(1.0, 31.0)
    values = 2.0 + 0.05 * x + rng.normal(0, 0.1, 30)
    values[4] = 50.0
    one = summarize_series("cue_speed", "m/s", x, values, np.full(30, 0.1))
    assert one.slope_low < 0.05 < one.slope_high
    assert one.slope == pytest.approx(0.05, abs=0.01)
    assert one.has_trend


def test_the_own_spread_leaves_out_the_measurement() -> None:
    rng = np.random.default_rng(1)
    values = 2.0 + rng.normal(0, 0.05, 400)
    wide = summarize_series("cue_speed", "m/s", np.arange(400.0), values, np.full(400, 0.03))
    assert wide.own_spread == pytest.approx(0.04, abs=0.006)
    assert summarize_series("cue_speed", "m/s", np.arange(400.0), values, np.full(400, 0.1)).own_spread == 0


def test_shots_without_the_number_do_not_count() -> None:
    one = summarize_series("throw", "deg", np.arange(3.0), np.array([np.nan, 1.0, 3.0]), np.ones(3))
    assert (one.count, one.median) == (2, 2.0)
    assert np.isnan(one.slope)
    assert not one.has_trend


def test_lengths_are_those_of_cue_ball_and_object_ball() -> None:
    numbers = collect_session_numbers(make_shot(2.0, 10.0))
    assert numbers["length"][0] == 3.0
    assert numbers["object_length"][0] == 1.0


def test_the_spread_of_a_player_wraps_around_the_circle() -> None:
    rng = np.random.default_rng(2)
    shots = [
        make_shot(2.0 * (1 + 0.03 * rng.normal()), (179.9 + 0.4 * rng.normal() + 180) % 360 - 180) for _ in range(300)
    ]
    speed, angle = estimate_player_spread(shots)
    assert speed == pytest.approx(0.03, rel=0.2)
    assert angle == pytest.approx(0.4, rel=0.2)


def test_one_shot_has_no_spread() -> None:
    with pytest.raises(ValueError, match="two shots"):
        estimate_player_spread([make_shot(2.0, 1.0)])


def test_the_range_of_few_shots_holds_the_median_as_often_as_computed() -> None:
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 6):
        values = rng.standard_normal((20_000, count))
        share = float(np.mean((values.min(axis=1) < 0) & (values.max(axis=1) > 0)))
        assert compute_range_coverage(count) == pytest.approx(share, abs=0.01)
