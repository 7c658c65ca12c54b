"""When the frames of a rally were taken."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.estimation.rally.rally_clock import estimate_capture_times


def follow_ball(taken: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Places (T, 2), px, of a ball that is hit every 0.8 s and bounces between, with noise."""
    t = taken % 0.8
    way = np.where((taken // 0.8).astype(int) % 2 == 0, 1.0, -1.0)
    x = 640 + way * (500 * t - 240 * t**2 - 200)
    y = 300 - 400 * np.where(t < 0.5, t, 0.5 - 0.7 * (t - 0.5)) + 300 * t**2
    return np.column_stack([x, y]) + rng.normal(0, 0.7, (len(taken), 2))


@pytest.mark.parametrize(("rate", "shown_rate"), [(25, 30), (24, 30), (50, 60)])
def test_frames_beside_which_others_are_shown_twice_were_taken_at_even_times(rate: int, shown_rate: int) -> None:
    count = 16 * rate // 5
    taken = np.arange(count) / rate
    shown = np.ceil(taken * shown_rate - 1e-9) / shown_rate
    px = follow_ball(taken, np.random.default_rng(rate))
    capture = estimate_capture_times(np.arange(count), px, np.full(count, 0.7), shown)
    assert np.diff(capture) == pytest.approx(np.full(count - 1, 1 / rate), rel=0.01)


def test_frames_beside_which_others_were_lost_were_taken_when_they_are_shown() -> None:
    shown = np.delete(np.arange(96) / 30, np.arange(5, 96, 6))
    px = follow_ball(shown, np.random.default_rng(1))
    assert estimate_capture_times(np.arange(80), px, np.full(80, 0.7), shown) is shown


def test_a_ball_that_is_hardly_seen_leaves_the_clock_of_the_clip() -> None:
    shown = np.ceil(np.arange(80) * 30 / 25) / 30
    rows = np.arange(0, 80, 2)
    px = follow_ball(np.arange(80) / 25, np.random.default_rng(2))[rows]
    assert estimate_capture_times(rows, px, np.full(40, 0.7), shown) is shown
