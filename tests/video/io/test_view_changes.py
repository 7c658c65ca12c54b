"""Titles, cuts and fades separate the views of a recording; people, balls and exposure do not."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import ByteArray
from video.calibration.shot_segmentation import is_replay
from video.io.view_changes import ViewMeter

RATE = 30
HEIGHT, WIDTH = 180, 320


def draw_scene(seed: int, ball: float = 0.5) -> ByteArray:
    """Draw a scene of soft blocks with a ball at a share of its width."""
    image = np.kron(np.random.default_rng(seed).integers(60, 160, (6, 8)), np.ones((30, 40))).astype(np.uint8)
    x = round(10 + (WIDTH - 20) * ball)
    image[88:96, x - 4 : x + 4] = 250
    return image


def find_views(images: list[ByteArray]) -> list[list[int]]:
    meter = ViewMeter()
    for image in images:
        meter.add_frame(image)
    views: list[list[int]] = meter.find_views(np.arange(len(images)) / RATE).tolist()
    return views


SHOT = [draw_scene(1, at) for at in np.linspace(0, 1, 90)]


def test_a_title_and_a_cut_separate_views() -> None:
    title, other = [np.full((HEIGHT, WIDTH), 20, np.uint8)] * 30, [draw_scene(2, at) for at in np.linspace(0, 1, 60)]
    assert find_views([*title, *SHOT, *other]) == [[0, 30], [30, 120], [120, 180]]


@pytest.mark.parametrize("seconds", [0.5, 1.0, 3.0])
def test_the_frames_of_a_fade_belong_to_no_view(seconds: float) -> None:
    count = round(seconds * RATE)
    fade = [np.asarray(SHOT[0] * share, np.uint8) for share in np.linspace(0, 1, count, endpoint=False)]
    ((first, stop),) = find_views([*fade, *SHOT])
    assert count - 4 <= first <= count + 4
    assert stop == count + len(SHOT)


def test_a_ball_a_person_and_an_exposure_that_adapts_are_one_view() -> None:
    images = [image.copy() for image in SHOT]
    for k in range(90):
        images[k][40:160, 3 * k : 3 * k + 40] = 30
        images[k] = np.asarray(images[k] + 10 * k / 90, np.uint8)
    assert find_views(images) == [[0, 90]]


def test_a_slowed_repeat_is_a_replay_and_the_same_path_at_another_pace_with_another_ball_is_none() -> None:
    assert is_replay([image for image in SHOT for _ in range(3)], SHOT)
    other = [image.copy() for image in SHOT]
    for k, image in enumerate(other):
        image[20:28, 10 + 2 * k : 18 + 2 * k] = 250
    assert not is_replay(other, SHOT)
    assert not is_replay(SHOT[::-1], SHOT)
