from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.rendered_balls import CLOTH, HEIGHT, PX_PER_M, RADIUS, WIDTH, Ball, draw, drawn_scene, misses, spread_balls

from detectors.apparent_ball_size import with_seen_size
from detectors.detect import detect_in_picture
from detectors.hough.hough_detector import ball_finder
from detectors.options import DetectOptions
from models.core.errors import ModelError

HOUGH = DetectOptions(detector="hough")
COLOURS = ((230, 230, 220), (200, 30, 40), (240, 190, 30), (20, 20, 25), (120, 40, 130), (30, 110, 60), (20, 60, 120))


def test_every_ball_is_found_and_nothing_else() -> None:
    rng = np.random.default_rng(1)
    balls = spread_balls(rng, COLOURS)
    found = detect_in_picture(draw(balls, rng), drawn_scene(), HOUGH)
    assert len(found) == len(balls)
    assert np.linalg.norm(misses(found, balls), axis=1).max() < 0.6


def test_centres_are_good_to_a_third_of_a_pixel_and_their_errors_honest() -> None:
    rng = np.random.default_rng(2)
    pulls = []
    for _ in range(4):
        balls = spread_balls(rng, COLOURS)
        found = ball_finder(drawn_scene(), [(0, draw(balls, rng))]).look(draw(balls, rng))
        miss = misses(found, balls)
        assert np.sqrt((miss**2).sum(axis=1).mean()) < 0.33
        pulls.append(miss / np.median(found.sigma))
    assert np.std(np.concatenate(pulls)) < 1.3
    assert np.abs(np.mean(np.concatenate(pulls), axis=0)).max() < 0.8


def test_touching_balls_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    step = 2 * RADIUS * PX_PER_M
    rack = [
        Ball(300 + row * step * 0.868, 180 + (place - row / 2) * step, COLOURS[(row + place) % 3])
        for row in range(5)
        for place in range(row + 1)
    ]
    found = detect_in_picture(draw(rack, rng), drawn_scene(), HOUGH)
    assert len(found) == 15
    assert np.linalg.norm(misses(found, rack), axis=1).max() < 1.0


@pytest.mark.parametrize("streak", [(24.0, 0.0), (0.0, 40.0), (28.0, -21.0)])
def test_a_fast_ball_is_measured_at_the_middle_of_its_streak(streak: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    rest = spread_balls(rng, COLOURS, 5)
    still = [draw(rest, rng) for _ in range(3)]
    ball = Ball(330.3, 275.6, (235, 235, 225), streak)
    found = ball_finder(drawn_scene(), list(enumerate(still))).look(draw([*rest, ball], rng))
    fast = np.flatnonzero(np.linalg.norm(found.streak, axis=1) > 0)
    assert len(found) == 6
    assert len(fast) == 1
    assert np.linalg.norm(found.centre[fast[0]] - [ball.x, ball.y]) < 0.8
    assert abs(np.linalg.norm(found.streak[fast[0]]) - np.hypot(*streak)) < 3.0
    assert abs(found.streak[fast[0]] @ streak) > 0.98 * np.linalg.norm(found.streak[fast[0]]) * np.hypot(*streak)


def test_a_cue_that_touches_the_cue_ball_does_not_hide_it() -> None:
    rng = np.random.default_rng(5)
    picture = draw([Ball(300.4, 180.2)], rng)
    cv2.line(picture, (291, 180), (20, 140), (205, 170, 120), 5, cv2.LINE_AA)
    found = detect_in_picture(picture, drawn_scene(), HOUGH)
    assert len(found) == 1
    assert np.linalg.norm(found.centre[0] - [300.4, 180.2]) < 0.8


def test_an_arm_over_the_table_is_no_ball() -> None:
    rng = np.random.default_rng(6)
    empty = [draw([], rng) for _ in range(3)]
    picture = draw([Ball(450.0, 120.0, (200, 30, 40))], rng)
    cv2.line(picture, (0, 300), (180, 230), (200, 150, 120), 36, cv2.LINE_AA)
    for finger in ((215, 205), (225, 222), (222, 238), (210, 250)):
        cv2.line(picture, (175, 232), finger, (205, 155, 125), 11, cv2.LINE_AA)
    found = ball_finder(drawn_scene(), list(enumerate(empty))).look(picture)
    assert len(found) <= 2
    assert np.linalg.norm(found.centre - [450.0, 120.0], axis=1).min() < 0.6


def test_projected_lines_and_rings_are_no_balls() -> None:
    rng = np.random.default_rng(7)
    picture = draw([Ball(200.0, 120.0, (200, 30, 40))], rng)
    cv2.line(picture, (100, 300), (560, 90), (90, 230, 240), 2, cv2.LINE_AA)
    cv2.circle(picture, (420, 230), 17, (90, 230, 240), 2, cv2.LINE_AA)
    found = detect_in_picture(picture, drawn_scene(), HOUGH)
    assert len(found) == 1


def test_an_empty_table_holds_no_balls() -> None:
    found = detect_in_picture(draw([], np.random.default_rng(8)), drawn_scene(), HOUGH)
    assert len(found) == 0


@pytest.mark.parametrize("factor", [0.8, 1.22])
def test_a_wrong_ball_size_is_put_right(factor: float) -> None:
    rng = np.random.default_rng(9)
    scene = drawn_scene()
    wrong = replace(scene, table=replace(scene.table, ball_radius=RADIUS * factor))
    pictures = [(0, draw(spread_balls(rng, COLOURS), rng))]
    assert with_seen_size(wrong, pictures).table.ball_radius == pytest.approx(RADIUS, rel=0.07)


def test_colour_and_white_tell_the_cue_ball() -> None:
    rng = np.random.default_rng(10)
    balls = [Ball(150, 150), Ball(300, 150, (200, 30, 40)), Ball(450, 150, (240, 190, 30))]
    found = detect_in_picture(draw(balls, rng), drawn_scene(), HOUGH)
    order = np.argsort(found.centre[:, 0])
    assert found.white[order[0]] > 0.9
    assert (found.white[order[1:]] < 0.1).all()
    assert found.colour[order[1], 1] > 30
    assert found.colour[order[2], 2] > 40


def test_the_same_picture_gives_the_same_bytes() -> None:
    picture = draw(spread_balls(np.random.default_rng(11), COLOURS), np.random.default_rng(12))
    first, second = detect_in_picture(picture, drawn_scene(), HOUGH), detect_in_picture(picture, drawn_scene(), HOUGH)
    assert first.centre.tobytes() == second.centre.tobytes()
    assert first.sigma.tobytes() == second.sigma.tobytes()


def test_a_network_that_is_not_there_is_refused_in_one_sentence() -> None:
    blank = np.full((HEIGHT, WIDTH, 3), CLOTH, dtype=np.uint8)
    with pytest.raises(ModelError, match=r"none\.onnx"):
        detect_in_picture(blank, drawn_scene(), DetectOptions(detector="onnx", model="none.onnx"))
