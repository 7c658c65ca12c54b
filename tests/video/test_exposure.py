from __future__ import annotations

import cv2
import numpy as np
import pytest

from models.core.typing import FloatArray
from video.matting.shutter_time import SHARES, _misfits, believed_share

Sighting = tuple[FloatArray, FloatArray, float]


def sighting(share: float, gain: float, speed: float) -> Sighting:
    """Squared errors by exposure, the least of them, at `share`, `gain` times that of a sharp ball; nothing is soft."""
    off = np.abs(SHARES - share) / share
    errors = 800 * (gain + (1 - gain) * np.minimum(off, 1.5) ** 2)
    return errors, errors, speed


def test_a_long_streak_is_believed_though_the_light_differs() -> None:
    seen = [sighting(0.5, 0.6, 3.0), sighting(0.5, 0.65, 2.5), sighting(0.5, 0.55, 2.8)]
    assert believed_share(seen) == pytest.approx(0.5, abs=0.03)


def test_of_streaks_that_explain_as_well_the_shortest_is_believed() -> None:
    agreed = believed_share([sighting(0.5, 0.6, 3.0)] * 4)
    doubted = believed_share([sighting(0.5, 0.6, 3.0)] * 2 + [sighting(0.4, 0.6, 3.0), sighting(0.7, 0.6, 3.0)])
    assert agreed == pytest.approx(0.5, abs=0.01)
    assert 0.35 < doubted < agreed


def test_a_ball_that_coding_softened_is_told_from_a_streak() -> None:
    radius, size = 12.0, 65
    apart = np.hypot(*np.mgrid[-32:33, -32:33])
    ball = np.clip(radius - apart + 0.5, 0, 1)[..., None].astype(np.float32) * np.float32([90, 60, -40])
    softened = cv2.GaussianBlur(ball, (0, 0), 0.2 * radius)
    streaked = cv2.blur(ball, (size // 4, 1))
    crisp, soft = _misfits(ball, softened, radius)
    assert soft < 0.01 * crisp
    assert _misfits(ball, streaked, radius)[1] > 3 * _misfits(streaked, streaked, radius)[1] + 1


def test_a_ball_that_is_a_little_more_alike_when_blurred_is_no_streak() -> None:
    assert believed_share([sighting(0.13, 0.6, 3.0), sighting(0.1, 0.65, 2.5)]) == 0


def test_a_short_streak_is_believed_where_it_explains_nearly_all() -> None:
    assert believed_share([sighting(0.17, 0.2, 3.0), sighting(0.17, 0.25, 2.5)]) == pytest.approx(0.17, abs=0.03)


def test_a_sighting_of_something_else_has_no_say() -> None:
    hand = 9000 + 0 * SHARES
    streaks = [sighting(0.17, 0.2, 3.0), sighting(0.17, 0.25, 2.5), sighting(0.17, 0.2, 2.0)]
    assert believed_share([*streaks, (hand, hand, 3.0)]) == believed_share(streaks)
