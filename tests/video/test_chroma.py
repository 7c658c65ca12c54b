"""The coarse colours of video, and pictures made of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import staged_shot as shot

from models.core.typing import ImageArray
from video.io.chroma import has_squares, square_colours
from video.io.clip import read_frames
from video.matting.background_plate import Plate
from video.matting.ball_timeline import sight
from video.synthesis.frame_synthesis import open_interval

TIMES = np.arange(31) / shot.RATE


def squared(picture: ImageArray) -> ImageArray:
    """The picture as a camera with coarse colours gives it."""
    square_colours(picture, (0, 0, shot.WIDTH, shot.HEIGHT))
    return picture


def filmed(t: float) -> ImageArray:
    """The staged shot, filmed so."""
    return squared(shot.film(t))


def test_decoded_pictures_have_squares_and_shifted_ones_do_not(tmp_path: Path) -> None:
    _, picture = next(read_frames(shot.clip_in(tmp_path, 6), indices=[1]))
    assert has_squares(picture)
    assert not has_squares(np.roll(picture, 1, axis=1))
    assert not has_squares(shot.film(0.5))


def test_a_picture_with_squares_is_hardly_changed_by_them() -> None:
    picture = filmed(0.5)
    again = picture.copy()
    square_colours(again, (0, 0, shot.WIDTH, shot.HEIGHT))
    assert np.abs(again.astype(int) - picture).max() <= 2


def test_squares_keep_brightness_and_what_lies_outside_the_box() -> None:
    rng = np.random.default_rng(4)
    picture = rng.integers(90, 160, (31, 41, 3)).astype(np.uint8)
    made = picture.copy()
    square_colours(made, (7, -3, 60, 21))
    bright = [p @ np.array([0.299, 0.587, 0.114]) for p in (made, picture)]
    assert np.abs(bright[0] - bright[1]).max() < 1
    assert np.array_equal(made[22:], picture[22:])
    assert np.array_equal(made[:, :6], picture[:, :6])
    assert has_squares(made[:22, 6:40])


def test_a_made_ball_has_its_colours_on_the_grid_of_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shot, "COLOURS", shot.COLOURS[::-1])  # the red ball moves
    sightings = sight(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    plate = Plate(squared(shot.cloth()), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))
    first, second = (float(t) for t in TIMES[10:12])
    t = 0.75 * first + 0.25 * second
    interval = open_interval(sightings, plate, 10, filmed(first), filmed(second))
    assert interval.squared
    centres = sightings.centres(t, sightings.state(np.array([t])).xy[0])
    errors = [
        float(((made.at(t, centres).astype(float) - filmed(t)) ** 2).mean())
        for made in (interval, replace(interval, squared=False))
    ]
    assert errors[0] < 0.2 * errors[1]


def test_squares_once_seen_are_kept_where_a_later_picture_cannot_tell() -> None:
    sightings = sight(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    plate = Plate(squared(shot.cloth()), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))
    pictures = [filmed(float(TIMES[10])), *(np.zeros_like(shot.cloth()) for _ in range(2))]
    interval = open_interval(sightings, plate, 10, *pictures[:2])
    later = open_interval(sightings, plate, 11, *pictures[1:], before=interval)
    assert later.squared
    assert not open_interval(sightings, plate, 11, *pictures[1:]).squared
