"""Balls placed by hand: measured where they were placed, and followed as long as they look the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run as shot

from detectors.placed_balls import add_placed_balls
from models.core.corrections import BallMark, BallPlace
from models.core.detections import Detections, MarkedDetections
from models.core.scene import Scene
from video.io.clip import Clip


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return shot.write_clip(tmp_path_factory.mktemp("placed") / "shot.mp4")


def make_scene() -> Scene:
    """The scene of the run, filmed by a pinhole camera 4 m above the middle of the table."""
    matrix = np.array([[400.0, 0, -120, 80], [0, 400.0, -70, 80], [0, 0, -1, 4]])
    scene = shot.make_scene()
    return replace(scene, camera=replace(scene.camera, matrix=matrix))


def detect(clip: Clip, balls: tuple[int, ...]) -> Detections:
    """Detections of some balls: 0 white, 1 red."""
    everything = shot.make_detections(shot.make_tracks(clip, shot.make_scene()))
    return everything.select_rows(np.isin(np.arange(len(everything)) % 2, balls))


def add(clip: Clip, detections: Detections, x: float, y: float, frame: int, **span: int) -> MarkedDetections:
    mark = BallMark("placed", BallPlace(frame, x, y), **span)
    return add_placed_balls(detections, clip, make_scene(), (mark,))


def test_a_resting_ball_is_followed_through_the_whole_clip(clip: Clip) -> None:
    marked = add(clip, detect(clip, (0,)), 170.8, 49.4, frame=7)
    placed = marked.detections.select_rows(marked.mark == 0)
    assert placed.frame.tolist() == list(range(shot.FRAMES))
    error = np.hypot(*(placed.centre - [170.0, 50.0]).T)
    assert error.max() < 1.1  # the error of the chosen place, which the sigma holds
    assert (error / placed.sigma).max() < 3
    assert np.ptp(placed.centre, axis=0).max() < 0.3
    assert placed.colour[:, 1].min() > 20  # red
    assert np.all(np.diff(marked.detections.frame) >= 0)


def test_a_moving_ball_is_followed_too(clip: Clip) -> None:
    t = 10 / shot.RATE
    marked = add(clip, detect(clip, (1,)), 20 + 100 * (0.2 + t), 70.0, frame=10)
    placed = marked.detections.select_rows(marked.mark == 0)
    true = 20 + 100 * (0.2 + placed.frame / shot.RATE)
    assert len(placed) == shot.FRAMES
    assert np.abs(placed.centre[:, 0] - true).max() < 0.7


def test_a_ball_is_placed_within_its_span_only(clip: Clip) -> None:
    marked = add(clip, detect(clip, (0,)), 170.0, 50.0, frame=7, first=5, last=9)
    assert marked.detections.frame[marked.mark == 0].tolist() == [5, 6, 7, 8, 9]


def test_a_ball_that_the_detector_has_is_not_there_twice(clip: Clip) -> None:
    detections = detect(clip, (0, 1))
    marked = add(clip, detections, 170.0, 50.0, frame=7)
    assert len(marked.detections) == len(detections)
    assert (marked.mark == 0).sum() == 1


def test_a_place_on_plain_cloth_counts_where_it_was_set(clip: Clip) -> None:
    marked = add(clip, detect(clip, (0, 1)), 100.0, 110.0, frame=3)
    placed = marked.detections.select_rows(marked.mark == 0)
    at = placed.frame.tolist().index(3)
    assert placed.centre[at].tolist() == [100.0, 110.0]
    assert placed.sigma[at] == 1.0
