"""Titles, cuts and fades separate the views of a recording; people, balls and exposure do not."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import ByteArray
from video.calibration.shot_segmentation import is_replay
from video.io.view_changes import JUMP_CLEARANCE, ViewMeter

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


def test_a_fade_out_and_in_of_one_camera_separates_two_views() -> None:
    shares = np.linspace(1, 0, 18)
    fade = [np.asarray(image * share, np.uint8) for image in (SHOT[-1], SHOT[0]) for share in shares]
    fade[18:] = fade[:17:-1]
    views = find_views([*SHOT, *fade, *SHOT])
    assert len(views) == 2
    assert views[0] == [0, pytest.approx(90, abs=4)]
    assert views[1] == [pytest.approx(126, abs=4), 216]


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


@pytest.mark.parametrize("pace", [1, 2])
def test_a_replay_may_carry_a_label_that_the_shot_does_not_have(pace: int) -> None:
    labelled = [image.copy() for image in SHOT for _ in range(pace)]
    for image in labelled:
        image[4:16, 4:60] = 255
    assert is_replay(labelled, SHOT)


def test_a_shot_with_balls_that_lie_elsewhere_is_no_replay() -> None:
    resting = [(60.0, 50.0), (200.0, 120.0), (250.0, 60.0)]
    earlier = [draw_table(*resting, (20 + 3 * k, 30)) for k in range(40)]
    moved = [(80.0, 70.0), (180.0, 120.0), (250.0, 90.0)]
    assert not is_replay([draw_table(*moved, (20 + 3 * k, 150 - k)) for k in range(40)], earlier)
    assert is_replay([draw_table(*resting, (20 + 3 * k, 30)) for k in range(40)], earlier)


BALL = 6
"""px, diameter."""


def draw_table(*balls: tuple[float, float], level: int = 220) -> ByteArray:
    """Draw balls on an even cloth."""
    image = np.full((HEIGHT, WIDTH), 90, np.uint8)
    rows, columns = np.indices(image.shape)
    for x, y in balls:
        image[np.hypot(columns - x, rows - y) <= BALL / 2] = level
    return image


def find_jumps(images: list[ByteArray]) -> list[tuple[int, int, int, int]]:
    """Return frame, place (px) and sign of each jump."""
    meter = ViewMeter()
    for image in images:
        meter.add_frame(image)
    size = np.array([WIDTH, HEIGHT])
    return [(int(k), *np.rint(place * size - 0.5).astype(int), int(sign)) for k, *place, sign in meter.jumps]


def test_balls_that_lie_elsewhere_from_one_frame_to_the_next_jump() -> None:
    before, after = ((60, 50), (200, 120), (250, 60)), ((120, 140), (200, 120), (90, 90))
    images = [draw_table(*before)] * 20 + [draw_table(*after)] * 20
    found = [(20, 60, 50, -1), (20, 90, 90, 1), (20, 120, 140, 1), (20, 250, 60, -1)]
    assert sorted(find_jumps(images)) == found
    assert find_views(images) == [[0, 40]], "a few balls are no new view by themselves"


@pytest.mark.parametrize("speed", [0.5, 4.0, JUMP_CLEARANCE * BALL - 2 * BALL])
@pytest.mark.parametrize("repeats", [1, 2, 5])
def test_a_struck_ball_that_stops_where_it_hits_another_one_is_no_jump(speed: float, repeats: int) -> None:
    """Both leave and take their places within a frame; frames are shown once, twice and five times."""
    steps = round(100 / speed)
    rolls = [draw_table((60 + speed * k, 50), (160 + 6, 50)) for k in range(steps)]
    hits = [draw_table((160, 50), (166 + speed * k, 50)) for k in range(1, round(60 / speed))]
    images = [rolls[0]] * 20 + [image for image in rolls + hits for _ in range(repeats)] + [hits[-1]] * 20
    assert find_jumps(images) == []


def test_letters_lines_of_light_and_a_hand_that_moves_balls_are_no_jump() -> None:
    still = [draw_table((60, 50), (200, 120))] * 20
    lit = [image.copy() for image in still]
    for image in lit:
        image[100, 50:150] = 250
        image[150:156, 80:160:8] = 250
    assert find_jumps([*still, *lit]) == [], "things only appear"
    shaded = [image.copy() for image in still]
    for image in shaded:
        image[20:60, 230:300] = 70
        image[30:36, 254:260], image[30:36, 270:276] = 90, 50
    twice = [image.copy() for image in shaded]
    for image in twice:
        image[30:36, 254:260], image[30:36, 270:276] = 50, 92
    assert find_jumps([*shaded, *twice]) == [], "what stands out before and after is no ball that comes or goes"
    moved = [draw_table((60, 50), (120, 60))] * 20
    for k, image in enumerate(moved):
        moved[k] = image.copy()
        moved[k][40:150, 4 * k : 4 * k + 100] = 40
    assert find_jumps([*still, *moved]) == []
