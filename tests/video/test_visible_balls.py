"""Which balls a picture shows though no detector saw them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from support import staged_shot as shot

from video.matting.background_plate import Plate
from video.matting.ball_timeline import Sightings, sight
from video.matting.visible_balls import shown_balls

ROW = 15
TIMES = np.arange(31) / shot.RATE
STRIPED = np.array([[30, 30, 200], [200, 40, 40]], dtype=np.uint8)
"""The ball was seen from its blue side for most of the clip; its white one is up now."""


def unseen() -> Sightings:
    """The cue ball is not observed in one picture, and mostly of another colour elsewhere."""
    sightings = sight(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    observed = sightings.observed.copy()
    observed[ROW, 0] = False
    return replace(sightings, observed=observed, colour=STRIPED)


def shows_cue(picture: NDArray[np.uint8]) -> bool:
    plate = Plate(shot.cloth(), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))
    return bool(shown_balls(unseen(), plate, ROW, picture)[0])


def test_a_ball_that_has_turned_another_side_up_is_shown() -> None:
    assert shows_cue(shot.film(float(TIMES[ROW])))


def test_cloth_is_no_ball() -> None:
    assert not shows_cue(shot.film(float(TIMES[ROW]), shown=(1,)))


def test_a_hand_over_the_place_of_a_ball_is_no_ball() -> None:
    picture = shot.film(float(TIMES[ROW]), shown=(1,))
    x, y = np.rint(shot.place(float(TIMES[ROW]))[0] * shot.SCALE + shot.MARGIN).astype(int)
    picture[y - 30 : y + 30, x - 30 : x + 30] = (220, 170, 140)
    assert not shows_cue(picture)
