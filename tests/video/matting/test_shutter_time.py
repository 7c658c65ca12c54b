from __future__ import annotations

import cv2
import numpy as np
import pytest

from models.core.typing import FloatArray
from video.matting.shutter_time import SHUTTER_SHARES, _streak_misfit, estimate_shutter_share

ViewErrors = tuple[FloatArray, FloatArray, float]


def view_errors(share: float, gain: float, speed: float) -> ViewErrors:
    """Squared errors by shutter share, least at `share` with `gain` times the error of a sharp ball; none is soft."""
    off = np.abs(SHUTTER_SHARES - share) / share
    errors = 800 * (gain + (1 - gain) * np.minimum(off, 1.5) ** 2)
    return errors, errors, speed


def test_a_long_streak_is_accepted_although_the_light_differs() -> None:
    views = [view_errors(0.5, 0.6, 3.0), view_errors(0.5, 0.65, 2.5), view_errors(0.5, 0.55, 2.8)]
    assert estimate_shutter_share(views) == pytest.approx(0.5, abs=0.03)


def test_the_shortest_of_equally_good_streaks_is_accepted() -> None:
    agreed = estimate_shutter_share([view_errors(0.5, 0.6, 3.0)] * 4)
    doubted = estimate_shutter_share(
        [view_errors(0.5, 0.6, 3.0)] * 2 + [view_errors(0.4, 0.6, 3.0), view_errors(0.7, 0.6, 3.0)]
    )
    assert agreed == pytest.approx(0.5, abs=0.01)
    assert 0.35 < doubted < agreed


def test_a_ball_that_coding_softened_is_distinguished_from_a_streak() -> None:
    radius, size = 12.0, 65
    apart = np.hypot(*np.mgrid[-32:33, -32:33])
    ball = np.clip(radius - apart + 0.5, 0, 1)[..., None].astype(np.float32) * np.float32([90, 60, -40])
    softened = cv2.GaussianBlur(ball, (0, 0), 0.2 * radius)
    streaked = cv2.blur(ball, (size // 4, 1))
    crisp, soft = _streak_misfit(ball, softened, radius)
    assert soft < 0.01 * crisp
    assert _streak_misfit(ball, streaked, radius)[1] > 3 * _streak_misfit(streaked, streaked, radius)[1] + 1


def test_a_ball_that_fits_a_little_better_when_blurred_is_no_streak() -> None:
    assert estimate_shutter_share([view_errors(0.13, 0.6, 3.0), view_errors(0.1, 0.65, 2.5)]) == 0


def test_a_short_streak_is_accepted_where_it_explains_nearly_everything() -> None:
    assert estimate_shutter_share([view_errors(0.17, 0.2, 3.0), view_errors(0.17, 0.25, 2.5)]) == pytest.approx(
        0.17, abs=0.03
    )


def test_a_view_of_another_object_has_no_influence() -> None:
    hand = 9000 + 0 * SHUTTER_SHARES
    streaks = [view_errors(0.17, 0.2, 3.0), view_errors(0.17, 0.25, 2.5), view_errors(0.17, 0.2, 2.0)]
    assert estimate_shutter_share([*streaks, (hand, hand, 3.0)]) == estimate_shutter_share(streaks)
