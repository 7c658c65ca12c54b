"""The network that is shipped, on drawn tables that its own training pictures share no code with."""

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
from support.rendered_balls import HEIGHT, RADIUS, WIDTH, Ball, draw, drawn_scene, misses, spread_balls

from detectors.detect import detect_in_picture
from detectors.network.network_detector import NetworkFinder, network_finder
from detectors.network.network_file import SHIPPED, BallModel, model_facts, open_model
from detectors.network.table_free_detection import balls_anywhere
from detectors.options import DetectOptions
from models.core.scene import Camera

COLOURS = ((230, 230, 220), (200, 30, 40), (240, 190, 30), (25, 25, 30), (120, 40, 130), (30, 110, 60), (170, 80, 30))
ONNX = DetectOptions(detector="onnx")
ROOT = Path(__file__).resolve().parents[2]
IMPORT = "\nimport onnxruntime"


@pytest.fixture(scope="module")
def model() -> BallModel:
    return open_model(SHIPPED)


def finder_for(model: BallModel, *pictures: np.ndarray) -> NetworkFinder:
    return network_finder(drawn_scene(), list(enumerate(pictures)), model)


def test_the_library_that_runs_networks_is_told_to_report_to_nobody(tmp_path: Path) -> None:
    """Where it may report, it names its session in a file among the temporary ones as soon as it is imported."""
    facts = {name: word for name, word in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    code = "from detectors.network.network_file import SHIPPED, open_model; open_model(SHIPPED)"
    home = {"TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], env=facts | home, check=True)
    assert not list(tmp_path.iterdir())
    rooms = ("models", "video", "detectors", "diagnosis", "pipeline")
    importing = [path for room in rooms for path in (ROOT / room).rglob("*.py") if IMPORT in path.read_text("utf-8")]
    assert importing == [ROOT / "video" / "inference.py"]


def test_every_ball_is_found_and_nothing_else() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        balls = spread_balls(rng, COLOURS)
        found = detect_in_picture(draw(balls, rng), drawn_scene(), ONNX)
        assert len(found) == len(balls)
        assert np.linalg.norm(misses(found, balls), axis=1).max() < 0.8


def test_centres_are_good_to_a_third_of_a_pixel_and_their_errors_honest(model: BallModel) -> None:
    rng = np.random.default_rng(2)
    off, pulls = [], []
    for _ in range(4):
        balls = spread_balls(rng, COLOURS)
        found = finder_for(model, draw(balls, rng)).look(draw(balls, rng))
        truth = np.array([[ball.x, ball.y] for ball in balls])
        nearest = np.argmin(np.linalg.norm(found.centre[None] - truth[:, None], axis=-1), axis=1)
        off.append(found.centre[nearest] - truth)
        pulls.append(off[-1] / found.sigma[nearest, None])
    assert np.sqrt((np.concatenate(off) ** 2).mean()) < 0.25
    assert np.std(np.concatenate(pulls)) < 1.3


def test_touching_balls_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    step = 2 * RADIUS * 220.0
    rack = [
        Ball(300 + row * step * 0.868, 180 + (place - row / 2) * step, COLOURS[(row + place) % 3])
        for row in range(4)
        for place in range(row + 1)
    ]
    found = detect_in_picture(draw(rack, rng), drawn_scene(), ONNX)
    assert len(found) == len(rack)
    assert np.linalg.norm(misses(found, rack), axis=1).max() < 1.0


@pytest.mark.parametrize("streak", [(20.0, 0.0), (16.0, -12.0)])
def test_a_fast_ball_is_one_ball_about_the_middle_of_its_streak(model: BallModel, streak: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    rest = spread_balls(rng, COLOURS, 5)
    ball = Ball(330.3, 275.6, (235, 235, 225), streak)
    found = finder_for(model, draw(rest, rng)).look(draw([*rest, ball], rng))
    assert len(found) == 6
    assert np.linalg.norm(misses(found, [ball])[0]) < 2.0


def test_an_empty_table_and_lines_hold_no_balls() -> None:
    rng = np.random.default_rng(8)
    empty = draw([], rng)
    cv2.line(empty, (100, 300), (560, 90), (90, 230, 240), 2, cv2.LINE_AA)
    cv2.circle(empty, (420, 230), 17, (90, 230, 240), 2, cv2.LINE_AA)
    assert len(detect_in_picture(empty, drawn_scene(), ONNX)) == 0


def test_a_ball_size_that_is_far_off_is_put_right(model: BallModel) -> None:
    rng = np.random.default_rng(9)
    scene = drawn_scene()
    wrong = replace(scene, table=replace(scene.table, ball_radius=1.3 * RADIUS))
    finder = network_finder(wrong, [(0, draw(spread_balls(rng, COLOURS), rng))], model)
    assert finder.view.scene.table.ball_radius == pytest.approx(RADIUS, rel=0.12)


def test_following_a_clip_sees_what_looking_at_every_picture_sees(model: BallModel) -> None:
    rng = np.random.default_rng(13)
    rest = spread_balls(rng, COLOURS, 5)
    paths = [[*rest, Ball(120.0 + 9 * k, 290.0, (235, 235, 225), (4.0, 0.0))] for k in range(8)]
    pictures = [draw(balls, rng) for balls in paths]
    finder = finder_for(model, pictures[0])
    memory = None
    for k, picture in enumerate(pictures):
        followed, memory = finder.follow(picture, k, memory)
        looked = finder.look(picture, k)
        assert len(followed) == len(looked) == 6
        order, other = np.argsort(followed.centre[:, 0]), np.argsort(looked.centre[:, 0])
        assert np.linalg.norm(followed.centre[order] - looked.centre[other], axis=1).max() < 1.0
        assert (followed.frame == k).all()


def test_errors_of_a_ball_at_rest_differ_from_picture_to_picture(model: BallModel) -> None:
    rng = np.random.default_rng(14)
    balls = spread_balls(rng, COLOURS, 6)
    finder = finder_for(model, draw(balls, rng))
    places, memory = [], None
    for k in range(5):
        found, memory = finder.follow(draw(balls, rng), k, memory)
        places.append(found.centre[np.lexsort((found.centre[:, 1].round(-1), found.centre[:, 0].round(-1)))])
    assert all((np.abs(first - second) > 1e-6).any(axis=1).mean() > 0.9 for first, second in pairwise(places))


def test_a_camera_that_drifts_is_followed(model: BallModel) -> None:
    rng = np.random.default_rng(15)
    balls = spread_balls(rng, COLOURS, 5)
    shift = np.array([7.3, -4.6])
    motion = np.stack([np.eye(3), np.array([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1.0]])])
    scene = drawn_scene()
    camera = scene.camera
    drifting = Camera(
        camera.matrix, WIDTH, HEIGHT, camera.corners_px, camera.corner_covariance, "cloth", camera.height, 1.0, motion
    )
    first = draw(balls, rng)
    moved = cv2.warpAffine(first, np.column_stack([np.eye(2), shift]), (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    finder = network_finder(replace(scene, camera=drifting), [(0, first)], model)
    found = finder.look(np.asarray(moved, dtype=np.uint8), 1)
    assert len(found) == len(balls)
    elsewhere = [replace(ball, x=ball.x + shift[0], y=ball.y + shift[1]) for ball in balls]
    assert np.linalg.norm(misses(found, elsewhere), axis=1).max() < 1.0


def test_balls_are_found_without_a_table_at_any_size(model: BallModel) -> None:
    rng = np.random.default_rng(16)
    balls = spread_balls(rng, COLOURS, 6)
    picture = draw(balls, rng)
    for times in (1, 3):
        large = np.asarray(cv2.resize(picture, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        found = balls_anywhere(large, model)
        truth = (np.array([[ball.x, ball.y] for ball in balls]) + 0.5) * times - 0.5
        gaps = np.linalg.norm(found.centre[None] - truth[:, None], axis=-1)
        assert (gaps.min(axis=1) < 2.0 * times).all()


def test_the_shipped_file_says_how_it_was_made_and_is_small() -> None:
    facts = model_facts(SHIPPED)
    recipe = json.loads(facts["trueroll.recipe"])
    assert "no real frame" in recipe["pictures"]
    assert json.loads(facts["trueroll.held_out"])["balls"] > 100
    assert SHIPPED.stat().st_size < 8e6
