"""Long shots are shortened alike, short ones are left whole."""

from __future__ import annotations

import numpy as np
import pytest
from support.reference_frames import PLANE

from diagnosis.fitting.shot_preparation import find_common_duration, shorten_recordings
from models.core.recording import Recording


def shot(number: int, seconds: float) -> Recording:
    t = np.arange(round(10 * seconds) + 1) / 10
    return Recording(number, np.arange(len(t)), t, ("a",), np.zeros((len(t), 1, 2)), np.ones((len(t), 1)), PLANE)


def test_the_longest_shots_share_what_short_ones_leave() -> None:
    shots = (shot(0, 2.0), shot(1, 12.0), shot(2, 9.0))
    duration = find_common_duration(shots, 14.0)
    assert duration == pytest.approx(6.0)
    assert [one.t[-1] for one in shorten_recordings(shots, duration)] == pytest.approx([2.0, 6.0, 6.0])


def test_shots_that_last_no_longer_than_allowed_stay_whole() -> None:
    shots = (shot(0, 2.0), shot(1, 3.0))
    duration = find_common_duration(shots, 6.0)
    assert np.isinf(duration)
    assert [len(one.t) for one in shorten_recordings(shots, duration)] == [21, 31]
