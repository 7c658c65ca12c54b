from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.rendered_balls import (
    CLOTH,
    HEIGHT,
    PX_PER_M,
    RADIUS,
    WIDTH,
    Ball,
    build_test_scene,
    nearest_errors,
    render_balls,
    spread_balls,
)

from detectors.detect import detect_in_image
from detectors.detect_options import DetectOptions
from detectors.hough.hough_detector import build_hough_detector
from detectors.measurement.frame_change import ForegroundScan
from detectors.measurement.frame_detections import FrameDetections
from models.core.errors import ModelError

HOUGH = DetectOptions(detector="hough")
COLOURS = ((230, 230, 220), (200, 30, 40), (240, 190, 30), (20, 20, 25), (120, 40, 130), (30, 110, 60), (20, 60, 120))


def test_every_ball_is_detected_and_nothing_else() -> None:
    rng = np.random.default_rng(1)
    balls = spread_balls(rng, COLOURS)
    detections = detect_in_image(render_balls(balls, rng), build_test_scene(), HOUGH)
    assert len(detections) == len(balls)
    assert np.linalg.norm(nearest_errors(detections, balls), axis=1).max() < 0.6


def test_centres_are_good_to_a_third_of_a_pixel_and_their_sigmas_calibrated() -> None:
    rng = np.random.default_rng(2)
    pulls = []
    for _ in range(4):
        balls = spread_balls(rng, COLOURS)
        detections = build_hough_detector(build_test_scene(), [(0, render_balls(balls, rng))]).detect(
            render_balls(balls, rng)
        )
        miss = nearest_errors(detections, balls)
        assert np.sqrt((miss**2).sum(axis=1).mean()) < 0.33
        pulls.append(miss / np.median(detections.sigma))
    assert np.std(np.concatenate(pulls)) < 1.3
    assert np.abs(np.mean(np.concatenate(pulls), axis=0)).max() < 0.8


def test_touching_balls_are_separated() -> None:
    rng = np.random.default_rng(3)
    step = 2 * RADIUS * PX_PER_M
    rack = [
        Ball(300 + row * step * 0.868, 180 + (place - row / 2) * step, COLOURS[(row + place) % 3])
        for row in range(5)
        for place in range(row + 1)
    ]
    detections = detect_in_image(render_balls(rack, rng), build_test_scene(), HOUGH)
    assert len(detections) == 15
    assert np.linalg.norm(nearest_errors(detections, rack), axis=1).max() < 1.0


@pytest.mark.parametrize("streak", [(24.0, 0.0), (0.0, 40.0), (28.0, -21.0)])
def test_a_fast_ball_is_measured_at_the_middle_of_its_streak(streak: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    rest = spread_balls(rng, COLOURS, 5)
    still = [render_balls(rest, rng) for _ in range(3)]
    ball = Ball(330.3, 275.6, (235, 235, 225), streak)
    detections = build_hough_detector(build_test_scene(), list(enumerate(still))).detect(
        render_balls([*rest, ball], rng)
    )
    fast = np.flatnonzero(np.linalg.norm(detections.streak, axis=1) > 0)
    assert len(detections) == 6
    assert len(fast) == 1
    assert np.linalg.norm(detections.centre[fast[0]] - [ball.x, ball.y]) < 0.8
    assert abs(np.linalg.norm(detections.streak[fast[0]]) - np.hypot(*streak)) < 3.0
    assert abs(detections.streak[fast[0]] @ streak) > 0.98 * np.linalg.norm(detections.streak[fast[0]]) * np.hypot(
        *streak
    )


def test_a_cue_that_touches_the_cue_ball_does_not_hide_it() -> None:
    rng = np.random.default_rng(5)
    image = render_balls([Ball(300.4, 180.2)], rng)
    cv2.line(image, (291, 180), (20, 140), (205, 170, 120), 5, cv2.LINE_AA)
    detections = detect_in_image(image, build_test_scene(), HOUGH)
    assert len(detections) == 1
    assert np.linalg.norm(detections.centre[0] - [300.4, 180.2]) < 0.8


def test_an_arm_over_the_table_is_no_ball() -> None:
    rng = np.random.default_rng(6)
    empty = [render_balls([], rng) for _ in range(3)]
    image = render_balls([Ball(450.0, 120.0, (200, 30, 40))], rng)
    cv2.line(image, (0, 300), (180, 230), (200, 150, 120), 36, cv2.LINE_AA)
    for finger in ((215, 205), (225, 222), (222, 238), (210, 250)):
        cv2.line(image, (175, 232), finger, (205, 155, 125), 11, cv2.LINE_AA)
    detections = build_hough_detector(build_test_scene(), list(enumerate(empty))).detect(image)
    assert len(detections) <= 2
    assert np.linalg.norm(detections.centre - [450.0, 120.0], axis=1).min() < 0.6


def test_projected_lines_and_rings_are_no_balls() -> None:
    rng = np.random.default_rng(7)
    image = render_balls([Ball(200.0, 120.0, (200, 30, 40))], rng)
    cv2.line(image, (100, 300), (560, 90), (90, 230, 240), 2, cv2.LINE_AA)
    cv2.circle(image, (420, 230), 17, (90, 230, 240), 2, cv2.LINE_AA)
    detections = detect_in_image(image, build_test_scene(), HOUGH)
    assert len(detections) == 1


def test_an_empty_table_holds_no_balls() -> None:
    detections = detect_in_image(render_balls([], np.random.default_rng(8)), build_test_scene(), HOUGH)
    assert len(detections) == 0


def test_colour_and_white_identify_the_cue_ball() -> None:
    rng = np.random.default_rng(10)
    balls = [Ball(150, 150), Ball(300, 150, (200, 30, 40)), Ball(450, 150, (240, 190, 30))]
    detections = detect_in_image(render_balls(balls, rng), build_test_scene(), HOUGH)
    order = np.argsort(detections.centre[:, 0])
    assert detections.white[order[0]] > 0.9
    assert (detections.white[order[1:]] < 0.1).all()
    assert detections.colour[order[1], 1] > 30
    assert detections.colour[order[2], 2] > 40


def test_the_same_image_gives_the_same_bytes() -> None:
    image = render_balls(spread_balls(np.random.default_rng(11), COLOURS), np.random.default_rng(12))
    first, second = detect_in_image(image, build_test_scene(), HOUGH), detect_in_image(image, build_test_scene(), HOUGH)
    assert first.centre.tobytes() == second.centre.tobytes()
    assert first.sigma.tobytes() == second.sigma.tobytes()


def test_a_network_that_is_not_there_is_refused_in_one_sentence() -> None:
    blank = np.full((HEIGHT, WIDTH, 3), CLOTH, dtype=np.uint8)
    with pytest.raises(ModelError, match=r"none\.onnx"):
        detect_in_image(blank, build_test_scene(), DetectOptions(detector="onnx", model="none.onnx"))


@pytest.mark.parametrize(("explained", "is_intruder"), [(0.76, False), (0.68, True)])
def test_a_shape_is_an_intruder_where_balls_explain_less_than_three_quarters(
    explained: float, is_intruder: bool
) -> None:
    """A pack of balls with its shadows leaves a quarter; an arm on which discs were found leaves more."""
    detector = build_hough_detector(build_test_scene(), [(0, render_balls([], np.random.default_rng(0)))])
    shape, radius = np.zeros(detector.view.radius.shape, bool), detector.view.median_radius
    top, left, height, width = 60, 60, 120, 240
    shape[top : top + height, left : left + width] = True
    scan = ForegroundScan(np.zeros((*shape.shape, 3), np.float32), np.zeros(shape.shape, np.float32), shape, ~shape)
    x, y = np.meshgrid(np.arange(left, left + explained * width - 1.15 * radius, 3), np.arange(top, top + height, 3))
    working = np.stack([x.ravel(), y.ravel()], axis=1)
    one = np.ones(len(working))
    centre = detector.view.reference_to_frame(detector.view.to_reference(working), 0)
    found = detector._find_intruders(FrameDetections(centre, radius * one, 0 * working, one, one, one), scan, 0)
    assert found[top + height // 2, left + width // 2] == is_intruder


def test_rings_of_light_are_no_balls_and_hide_none() -> None:
    """A projector draws thick ones over the cloth, which cover as much as a ball does, and thin ones around balls."""
    rng = np.random.default_rng(9)
    balls = spread_balls(rng, COLOURS, 5)
    cloth = [(k, render_balls(balls, rng)) for k in range(3)]
    ring = np.zeros((HEIGHT, WIDTH), np.uint8)
    rings = [(330, 275, 0.8, 4), (420, 260, 0.85, 4), *((ball.x, ball.y, 1.6, 2) for ball in balls)]
    for x, y, radii, thickness in rings:
        at = round(16 * x), round(16 * y)
        cv2.circle(ring, at, round(16 * radii * RADIUS * PX_PER_M), 255, thickness, cv2.LINE_AA, 4)
    lit = np.clip(render_balls(balls, rng) * (1 + 1.2 * ring[..., None] / 255), 0, 255).astype(np.uint8)
    detections = build_hough_detector(build_test_scene(), cloth).detect(lit)
    assert len(detections) == len(balls)
    assert np.linalg.norm(nearest_errors(detections, balls), axis=1).max() < 1.0


def test_a_ball_where_a_cue_rested_is_opaque() -> None:
    """The cue becomes a marking of the cloth, and differs little from a white ball in its place."""
    rng = np.random.default_rng(11)
    ball = Ball(300, 200, (240, 235, 225))
    cloth = [(k, render_balls([], rng)) for k in range(3)]
    for _, image in cloth:
        cv2.line(image, (100, 200), (300, 200), (225, 205, 170), round(0.8 * RADIUS * PX_PER_M), cv2.LINE_AA)
    detections = build_hough_detector(build_test_scene(), cloth).detect(render_balls([ball], rng))
    assert len(detections) == 1
    assert nearest_errors(detections, [ball]).max() < 1.0


def test_a_disc_that_is_drawn_over_the_image_is_no_ball() -> None:
    """It has one level, which the noise of coding spreads by 1.5 %; a ball of that colour is shaded."""
    rng = np.random.default_rng(10)
    balls = [Ball(150, 120, (240, 190, 30)), Ball(450, 120, (235, 225, 205))]
    cloth = [(k, render_balls(balls, rng)) for k in range(3)]
    image = render_balls(balls, rng)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.circle(mask, (16 * 300, 16 * 200), round(16 * RADIUS * PX_PER_M), 255, -1, cv2.LINE_AA, 4)
    drawn = np.array([240.0, 190.0, 30.0]) + rng.normal(0, 3.0, image.shape)
    image = np.clip(image + (drawn - image) * mask[..., None] / 255, 0, 255).astype(np.uint8)
    detections = build_hough_detector(build_test_scene(), cloth).detect(image)
    assert len(detections) == len(balls)
    assert np.linalg.norm(nearest_errors(detections, balls), axis=1).max() < 1.0
