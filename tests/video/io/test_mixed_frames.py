"""Frames that a conversion of the frame rate mixed are recognised by the rhythm of their changes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from models.core.typing import FloatArray
from video.io.duplicate_frames import find_blending

PERIOD = 6
"""Frames of the file after which the rhythm of 25 fps in 30 fps recurs."""


def measure_changes(lag: int, periods: int) -> FloatArray:
    """Return the largest share of an image that each frame gains or loses over `lag` frames."""
    shares = np.zeros((3 * PERIOD, 3 * PERIOD))
    for k in range(3 * PERIOD):
        whole, part = divmod(5 * k, PERIOD)
        shares[k, whole] += 1 - part / PERIOD
        shares[k, whole + 1] += part / PERIOD
    change = np.abs(shares[lag:] - shares[:-lag]).max(axis=1)[PERIOD - lag : 2 * PERIOD - lag]
    return 200.0 * np.tile(change, periods)


@pytest.mark.parametrize("periods", [10, 10_000])
def test_mixed_frames_are_recognised_in_a_clip_and_in_a_long_recording(periods: int) -> None:
    blending = find_blending(measure_changes(1, periods), measure_changes(3, periods))
    assert blending is not None
    assert blending.ratio == Fraction(5, 6)
    assert np.mean(blending.is_mixed) == pytest.approx(0.5, abs=0.2)


def test_changes_without_a_rhythm_are_no_mixture() -> None:
    change = np.random.default_rng(1).uniform(60, 200, 300)
    assert find_blending(change, change) is None
