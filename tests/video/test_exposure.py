from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from video.exposure import SHARES, believed_share

Floats = NDArray[np.float64]


def errors(share: float, gain: float) -> Floats:
    """Squared errors by exposure, the least of them, at `share`, `gain` times that of a sharp ball."""
    off = np.abs(SHARES - share) / share
    return 800 * (gain + (1 - gain) * np.minimum(off, 1.5) ** 2)


def test_a_long_streak_is_believed_though_the_light_differs() -> None:
    seen = [(errors(0.5, 0.6), 3.0), (errors(0.5, 0.65), 2.5), (errors(0.4, 0.55), 2.8)]
    assert believed_share(seen) == pytest.approx(0.5, abs=0.08)


def test_a_ball_that_is_a_little_more_alike_when_blurred_is_no_streak() -> None:
    assert believed_share([(errors(0.13, 0.6), 3.0), (errors(0.1, 0.65), 2.5)]) == 0


def test_a_short_streak_is_believed_where_it_explains_nearly_all() -> None:
    assert believed_share([(errors(0.17, 0.2), 3.0), (errors(0.17, 0.25), 2.5)]) == pytest.approx(0.17, abs=0.03)


def test_a_sighting_of_something_else_has_no_say() -> None:
    hand = 9000 + 0 * SHARES
    streaks = [(errors(0.17, 0.2), 3.0), (errors(0.17, 0.25), 2.5), (errors(0.17, 0.2), 2.0)]
    assert believed_share([*streaks, (hand, 3.0)]) == believed_share(streaks)
