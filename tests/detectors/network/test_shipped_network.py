"""The shipped network, on rendered tables that share no code with its training images."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.rendered_balls import (
    HEIGHT,
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
from detectors.network.ball_model import SHIPPED_BALL_MODEL, BallModel, open_ball_model, read_model_metadata
from detectors.network.network_detector import NetworkDetector, build_network_detector
from detectors.still_images import detect_without_table
from models.core.scene import Camera

COLOURS = ((230, 230, 220), (200, 30, 40), (240, 190, 30), (25, 25, 30), (120, 40, 130), (30, 110, 60), (170, 80, 30))
ONNX = DetectOptions(detector="onnx")
ROOT = Path(__file__).resolve().parents[3]
IMPORT = "\nimport onnxruntime"


@pytest.fixture(scope="module")
def model() -> BallModel:
    return open_ball_model(SHIPPED_BALL_MODEL)


def detector_for(model: BallModel, *images: np.ndarray) -> NetworkDetector:
    return build_network_detector(build_test_scene(), list(enumerate(images)), model)


def test_the_telemetry_of_onnxruntime_is_off(tmp_path: Path) -> None:
    """With telemetry, it writes a temporary file with the name of its session as soon as it is imported."""
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    code = "from detectors.network import ball_model; ball_model.open_ball_model(ball_model.SHIPPED_BALL_MODEL)"
    home = {"TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], env=environment | home, check=True)
    assert not list(tmp_path.iterdir())
    packages = ("models", "video", "detectors", "diagnosis", "pipeline")
    importing = [
        path for package in packages for path in (ROOT / package).rglob("*.py") if IMPORT in path.read_text("utf-8")
    ]
    assert importing == [ROOT / "video" / "io" / "onnx_session.py"]


def test_every_ball_is_detected_and_nothing_else() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        balls = spread_balls(rng, COLOURS)
        detections = detect_in_image(render_balls(balls, rng), build_test_scene(), ONNX)
        assert len(detections) == len(balls)
        assert np.linalg.norm(nearest_errors(detections, balls), axis=1).max() < 0.8


@pytest.mark.parametrize("shrink", [2, 3])
def test_every_ball_is_detected_where_the_table_is_small_in_the_image(shrink: int) -> None:
    """Balls of 4 and 2.7 px are below the sizes that the network knows, so it sees the image enlarged."""
    whole, size = build_test_scene().camera, (WIDTH // shrink, HEIGHT // shrink)
    matrix = np.array([[1 / shrink, 0, 0.5 / shrink - 0.5], [0, 1 / shrink, 0.5 / shrink - 0.5], [0, 0, 1]])
    corners = (whole.corners_px + 0.5) / shrink - 0.5
    camera = Camera(matrix @ whole.matrix, *size, corners, np.eye(8), "cloth", 1000.0, 1.0)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        balls = spread_balls(rng, COLOURS)
        image = cv2.resize(render_balls(balls, rng), size, interpolation=cv2.INTER_AREA)
        detections = detect_in_image(image, replace(build_test_scene(), camera=camera), ONNX)
        true = (np.array([[ball.x, ball.y] for ball in balls]) + 0.5) / shrink - 0.5
        assert len(detections) == len(balls)
        assert np.linalg.norm(true[:, None] - detections.centre, axis=-1).min(axis=1).max() < 0.5


def test_centres_are_good_to_a_third_of_a_pixel_and_their_sigmas_calibrated(model: BallModel) -> None:
    rng = np.random.default_rng(2)
    off, pulls = [], []
    for _ in range(4):
        balls = spread_balls(rng, COLOURS)
        detections = detector_for(model, render_balls(balls, rng)).detect(render_balls(balls, rng))
        truth = np.array([[ball.x, ball.y] for ball in balls])
        nearest = np.argmin(np.linalg.norm(detections.centre[None] - truth[:, None], axis=-1), axis=1)
        off.append(detections.centre[nearest] - truth)
        pulls.append(off[-1] / detections.sigma[nearest, None])
    assert np.sqrt((np.concatenate(off) ** 2).mean()) < 0.25
    assert np.std(np.concatenate(pulls)) < 1.3


def test_touching_balls_are_separated() -> None:
    rng = np.random.default_rng(3)
    step = 2 * RADIUS * 220.0
    rack = [
        Ball(300 + row * step * 0.868, 180 + (place - row / 2) * step, COLOURS[(row + place) % 3])
        for row in range(4)
        for place in range(row + 1)
    ]
    detections = detect_in_image(render_balls(rack, rng), build_test_scene(), ONNX)
    assert len(detections) == len(rack)
    assert np.linalg.norm(nearest_errors(detections, rack), axis=1).max() < 1.0


@pytest.mark.parametrize("streak", [(20.0, 0.0), (16.0, -12.0)])
def test_a_fast_ball_is_one_ball_about_the_middle_of_its_streak(model: BallModel, streak: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    rest = spread_balls(rng, COLOURS, 5)
    ball = Ball(330.3, 275.6, (235, 235, 225), streak)
    detections = detector_for(model, render_balls(rest, rng)).detect(render_balls([*rest, ball], rng))
    assert len(detections) == 6
    assert np.linalg.norm(nearest_errors(detections, [ball])[0]) < 2.0


def test_an_empty_table_and_lines_hold_no_balls() -> None:
    rng = np.random.default_rng(8)
    empty = render_balls([], rng)
    cv2.line(empty, (100, 300), (560, 90), (90, 230, 240), 2, cv2.LINE_AA)
    cv2.circle(empty, (420, 230), 17, (90, 230, 240), 2, cv2.LINE_AA)
    assert len(detect_in_image(empty, build_test_scene(), ONNX)) == 0


def test_following_a_clip_detects_what_searching_every_frame_detects(model: BallModel) -> None:
    rng = np.random.default_rng(13)
    rest = spread_balls(rng, COLOURS, 5)
    paths = [[*rest, Ball(120.0 + 9 * k, 290.0, (235, 235, 225), (4.0, 0.0))] for k in range(8)]
    images = [render_balls(balls, rng) for balls in paths]
    detector = detector_for(model, images[0])
    memory = None
    for k, image in enumerate(images):
        followed, memory = detector.detect_next(image, k, memory)
        searched = detector.detect(image, k)
        assert len(followed) == len(searched) == 6
        order, other = np.argsort(followed.centre[:, 0]), np.argsort(searched.centre[:, 0])
        assert np.linalg.norm(followed.centre[order] - searched.centre[other], axis=1).max() < 1.0
        assert (followed.frame == k).all()


def test_errors_of_a_ball_at_rest_differ_from_frame_to_frame(model: BallModel) -> None:
    rng = np.random.default_rng(14)
    balls = spread_balls(rng, COLOURS, 6)
    detector = detector_for(model, render_balls(balls, rng))
    places, memory = [], None
    for k in range(5):
        detections, memory = detector.detect_next(render_balls(balls, rng), k, memory)
        places.append(
            detections.centre[np.lexsort((detections.centre[:, 1].round(-1), detections.centre[:, 0].round(-1)))]
        )
    assert all((np.abs(first - second) > 1e-6).any(axis=1).mean() > 0.9 for first, second in pairwise(places))


def test_a_camera_that_drifts_is_followed(model: BallModel) -> None:
    rng = np.random.default_rng(15)
    balls = spread_balls(rng, COLOURS, 5)
    shift = np.array([7.3, -4.6])
    motion = np.stack([np.eye(3), np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1.0]])])
    scene = build_test_scene()
    camera = scene.camera
    drifting = Camera(
        camera.matrix, WIDTH, HEIGHT, camera.corners_px, camera.corner_covariance, "cloth", camera.height, 1.0, motion
    )
    first = render_balls(balls, rng)
    moved = cv2.warpAffine(first, np.column_stack([np.eye(2), shift]), (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    detector = build_network_detector(replace(scene, camera=drifting), [(0, first)], model)
    detections = detector.detect(np.asarray(moved, dtype=np.uint8), 1)
    assert len(detections) == len(balls)
    elsewhere = [replace(ball, x=ball.x + shift[0], y=ball.y + shift[1]) for ball in balls]
    assert np.linalg.norm(nearest_errors(detections, elsewhere), axis=1).max() < 1.0


def test_balls_are_detected_without_a_table_at_any_size(model: BallModel) -> None:
    rng = np.random.default_rng(16)
    balls = spread_balls(rng, COLOURS, 6)
    image = render_balls(balls, rng)
    for times in (1, 3):
        large = np.asarray(cv2.resize(image, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        detections = detect_without_table(large, model)
        truth = (np.array([[ball.x, ball.y] for ball in balls]) + 0.5) * times - 0.5
        gaps = np.linalg.norm(detections.centre[None] - truth[:, None], axis=-1)
        assert (gaps.min(axis=1) < 2.0 * times).all()


def test_the_shipped_file_describes_its_training_and_is_small() -> None:
    facts = read_model_metadata(SHIPPED_BALL_MODEL)
    recipe = json.loads(facts["trueroll.recipe"])
    assert "no real frame" in recipe["pictures"]
    assert json.loads(facts["trueroll.held_out"])["balls"] > 100
    assert SHIPPED_BALL_MODEL.stat().st_size < 8e6
