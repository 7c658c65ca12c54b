"""Capture times from the motion of balls."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock
from models.core.typing import FloatArray
from models.estimation.reconstruction.capture_times import estimate_capture_times

SIGMA, FLOOR = 5e-4, 2e-4
"""m: noise of the samples, and the error that does not average out."""


def make_rolling_tracks(taken: FloatArray, shown: FloatArray, rng: np.random.Generator, balls: int = 3) -> Tracks:
    """Balls that roll out, one of them struck in between, one off a cushion and one hit head-on, with noise."""
    xy = np.empty((len(taken), balls, 2))
    for ball in range(balls):
        turn, speed, moment = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 1.5), rng.uniform(0.2, 1.5)
        way = np.array([np.cos(turn), np.sin(turn)])
        before, after = [(0.0, speed), (speed, speed), (speed, 0.3 * speed)][ball % 3]
        heading = np.array([-way[0], way[1]]) if ball % 3 == 1 else way
        early, late = np.minimum(taken, moment), np.maximum(taken - moment, 0.0)
        xy[:, ball] = before * early[:, None] * way + (after * late - 0.05 * late**2)[:, None] * heading
    xy += rng.normal(0, SIGMA, xy.shape)
    one = np.full((len(taken), balls), SIGMA)
    names = tuple(f"ball-{k}" for k in range(balls))
    return Tracks(
        np.arange(len(taken)), shown, names, ("ball",) * balls, xy, 500 * xy, one, one, np.zeros_like(xy), 10 * one,
        np.zeros((balls, 3)),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_an_even_clock_is_left_alone_whatever_the_balls_do(seed: int) -> None:
    t = np.arange(90) / 30
    tracks = make_rolling_tracks(t, t, np.random.default_rng(seed))
    assert estimate_capture_times(tracks, FLOOR).capture_time is tracks.t


@pytest.mark.parametrize("every", [4, 5])
def test_a_conversion_that_drops_one_frame_after_several_is_recognised(every: int) -> None:
    number = np.arange(100)
    dropped = number % (every + 1) == 3
    shown = np.arange(np.sum(~dropped)) * (every + 1) / every / 30
    clock = estimate_capture_times(
        make_rolling_tracks(number[~dropped] / 30, shown, np.random.default_rng(every)), FLOOR
    )
    assert np.diff(clock.capture_time) == pytest.approx(np.diff(number[~dropped]) / 30, abs=1e-9)


def test_frames_held_for_two_and_three_intervals_in_turn_were_captured_evenly() -> None:
    taken = np.arange(60) / 25
    shown = np.round(taken * 60) / 60
    clock = estimate_capture_times(make_rolling_tracks(taken, shown, np.random.default_rng(1)), FLOOR)
    assert np.diff(clock.capture_time) == pytest.approx(np.full(59, 1 / 25), rel=0.01)


def test_a_frame_lost_without_a_trace_is_found() -> None:
    number = np.delete(np.arange(90), [40, 65])
    clock = estimate_capture_times(
        make_rolling_tracks(number / 30, np.arange(88) / 30, np.random.default_rng(2)), FLOOR
    )
    assert np.diff(clock.capture_time) == pytest.approx(np.diff(number) / 30, abs=1e-9)


def test_irregular_times_are_estimated_to_a_fraction_of_their_jitter() -> None:
    rng = np.random.default_rng(3)
    shown = np.arange(90) / 30
    taken = shown + rng.normal(0, 0.15 / 30, 90)
    clock = estimate_capture_times(make_rolling_tracks(taken, shown, rng, balls=6), FLOOR)
    assert np.std(np.diff(clock.capture_time - taken)) < 0.3 * np.std(np.diff(shown - taken))


def test_the_conversions_of_a_clock_are_inverse() -> None:
    clock = CaptureClock(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.8, 2.1]), np.zeros(3))
    t = np.linspace(-1, 3, 41)
    assert clock.presentation_time_at(clock.capture_time_at(t)) == pytest.approx(t)
    steps = np.array([0.4, 1.0, 2.5])
    slope = (clock.presentation_time_at(steps + 1e-6) - clock.presentation_time_at(steps)) / 1e-6
    assert clock.presentation_rate_at(steps) == pytest.approx(slope)
