"""Balls that are visible in a frame although no detector found them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support import staged_shot as shot

from video.matting.background_plate import BackgroundPlate
from video.matting.ball_timeline import BallTimeline, build_ball_timeline
from video.matting.hidden_background import find_visible_balls

ROW = 15
TIMES = np.arange(31) / shot.RATE
STRIPED = np.array([[30, 30, 200], [200, 40, 40]], dtype=np.uint8)
"""The ball showed its blue side for most of the clip; its white side is up now."""


def timeline_without_detection() -> BallTimeline:
    """The cue ball is undetected in one frame, and mostly of another colour elsewhere."""
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    observed = timeline.observed.copy()
    observed[ROW, 0] = False
    return replace(timeline, observed=observed, colour=STRIPED)


def shows_cue(image: NDArray[np.uint8]) -> bool:
    plate = BackgroundPlate(shot.cloth(), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))
    return bool(find_visible_balls(timeline_without_detection(), plate, ROW, image)[0])


def test_a_ball_that_shows_another_side_is_visible() -> None:
    assert shows_cue(shot.film(float(TIMES[ROW])))


def test_cloth_is_no_ball() -> None:
    assert not shows_cue(shot.film(float(TIMES[ROW]), shown=(1,)))


def test_a_hand_over_the_place_of_a_ball_is_no_ball() -> None:
    image = shot.film(float(TIMES[ROW]), shown=(1,))
    x, y = np.rint(shot.place(float(TIMES[ROW]))[0] * shot.SCALE + shot.MARGIN).astype(int)
    image[y - 30 : y + 30, x - 30 : x + 30] = (220, 170, 140)
    assert not shows_cue(image)


@pytest.mark.parametrize(
    ("observed", "radii", "is_matted"),
    [(False, 1.7, False), (False, 2.3, True), (True, 0.85, False), (True, 1.15, True)],
)
def test_a_slow_ball_that_overlaps_another_is_not_matted(observed: bool, radii: float, is_matted: bool) -> None:
    """Its matte would hold half of the other ball; an undetected ball must leave it by more."""
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    centre, seen, radius = timeline.centre.copy(), timeline.observed.copy(), float(timeline.radius[ROW, 0])
    centre[ROW, 1] = centre[ROW, 0] + [1.5 * radius, 0.0]
    centre[ROW + 1] = centre[ROW] + [[-radii * radius, 0.0], [0.0, 0.0]]
    seen[ROW, 0] = observed
    assert (0 in replace(timeline, centre=centre, observed=seen).balls_to_matte(ROW)) == is_matted
