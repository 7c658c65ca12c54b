"""Nothing moves before the cue strikes."""

from __future__ import annotations

import numpy as np

from models.estimation.segmentation.jitter_removal import extend_rest_until_hit
from models.estimation.segmentation.track_segmentation import BallSamples, SampleRange

T = np.arange(60) / 30
STRIKE = 0.5
SIGMA = 2e-3


def track(place: tuple[float, float], v: tuple[float, float], start: float, seed: int) -> BallSamples:
    """A ball that rolls off with v from `start` s on, slower and slower."""
    rolled = np.maximum(T - start, 0.0)
    speed = float(np.hypot(*v))
    lasts = np.minimum(rolled, speed / 0.1)
    way = lasts * (1 - 0.05 * lasts / speed)
    noise = np.random.default_rng(seed).normal(0, SIGMA, (len(T), 2))
    return BallSamples(T, np.array(place) + np.outer(way, v) + noise, np.full(len(T), SIGMA))


def make_struck_ball() -> tuple[BallSamples, list[SampleRange]]:
    last = int(np.searchsorted(T, STRIKE))
    return track((0.5, 0.5), (2.0, 0.3), STRIKE, 1), [
        SampleRange(0, last - 1, True),
        SampleRange(last, len(T) - 1, False),
    ]


def test_a_ball_of_a_rack_rests_until_the_first_one_sets_off() -> None:
    cue, cue_parts = make_struck_ball()
    slow = track((1.5, 0.5), (0.04, 0.02), STRIKE, 2)
    parts = extend_rest_until_hit([cue, slow], [cue_parts, [SampleRange(0, len(T) - 1, False)]])[1]
    assert [part.static for part in parts] == [True, False]
    assert abs(T[parts[1].first] - STRIKE) < 0.04
    assert (parts[0].last + 1, parts[1].last) == (parts[1].first, len(T) - 1)


def test_a_ball_that_rolls_from_the_beginning_does_not_rest() -> None:
    cue, cue_parts = make_struck_ball()
    rolling = [SampleRange(0, len(T) - 1, False)]
    assert extend_rest_until_hit([cue, track((1.5, 0.5), (0.1, 0.0), -1.0, 3)], [cue_parts, rolling])[1] == rolling


def test_where_nothing_sets_off_nothing_changes() -> None:
    rolling = [SampleRange(0, len(T) - 1, False)]
    samples = [track((1.5, 0.5), (0.04, 0.0), STRIKE, 4), track((1.0, 0.5), (0.3, 0.0), -0.5, 5)]
    assert extend_rest_until_hit(samples, [rolling, rolling]) == [rolling, rolling]


def test_a_false_contact_before_the_strike_is_removed() -> None:
    cue, cue_parts = make_struck_ball()
    slow = track((1.5, 0.5), (0.3, 0.2), STRIKE + 0.1, 6)
    ghost = [SampleRange(0, 5, False), SampleRange(6, len(T) - 1, False)]
    parts = extend_rest_until_hit([cue, slow], [cue_parts, ghost])[1]
    assert parts[0].static
    assert parts[0].last >= int(np.searchsorted(T, STRIKE)) - 1
