"""The second pass where balls crowd."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest
from support.rendered_balls import PX_PER_M, RADIUS, Ball, build_test_scene, render_balls

from detectors.measurement.cloth_background import learn_cloth_background
from detectors.measurement.working_view import WorkingView, build_view
from detectors.network.peak_decoding import APPEARANCES, CandidateDetections
from detectors.network.second_pass import ENLARGED_RADIUS_PX, SearchedFrame, run_second_pass

DOT = (255, 0, 255)
RADIUS_PX = RADIUS * PX_PER_M
BALLS = ((300.0, 170.0), (309.0, 176.0), (450.0, 120.0))


@dataclass(frozen=True)
class DotModel:
    """Finds dots of one colour exactly, and records the sizes of its input images."""

    input_sizes: list[tuple[int, int]] = field(default_factory=list)

    def find_candidates(self, rgb: np.ndarray, radius: float) -> CandidateDetections:
        self.input_sizes.append(rgb.shape[:2])
        away = np.abs(rgb.astype(int) - DOT).sum(axis=2)
        _, _, _, places = cv2.connectedComponentsWithStats((away < 160).astype(np.uint8))
        return peaks(places[1:], radius, 0.9)


def peaks(centre: np.ndarray, radius: float, score: float) -> CandidateDetections:
    count = len(centre)
    one = np.ones(count)
    return CandidateDetections(
        centre.reshape(-1, 2),
        radius * one,
        np.zeros((count, 2)),
        score * one,
        one,
        one,
        np.zeros((count, len(APPEARANCES))),
    )


def image_with_dots() -> tuple[np.ndarray, WorkingView]:
    """An image with a dot, 5 px on a side, in the middle of each ball, and its view."""
    image = render_balls([Ball(x, y) for x, y in BALLS], np.random.default_rng(1), noise=0.0)
    for x, y in BALLS:
        image[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3] = DOT
    return image, build_view(build_test_scene())


def pass_twice(
    image: np.ndarray, view: WorkingView, model: DotModel, candidates: CandidateDetections
) -> CandidateDetections:
    working = view.working_image(image)
    searched = SearchedFrame(image, working, np.ones(working.shape[:2], dtype=bool), 0)
    return run_second_pass(searched, view, learn_cloth_background([working], view), model, candidates)


def test_crowded_balls_are_where_the_second_pass_finds_them() -> None:
    image, view = image_with_dots()
    model = DotModel()
    guessed = view.to_working(np.array(BALLS) + np.array([[2.0, 1.0], [-2.0, 1.0], [1.5, 0.0]]))
    detections = pass_twice(image, view, model, peaks(guessed, view.median_radius, 0.9))
    truth = view.to_working(np.array(BALLS))
    assert len(detections) == 3
    apart = np.linalg.norm(detections.centre[:, None] - truth[None], axis=-1).min(axis=0)
    assert apart[:2].max() < 0.3
    # The lone one keeps its first position.
    assert np.linalg.norm(detections.centre - guessed[2], axis=1).min() == 0.0
    assert np.allclose(detections.radius, view.median_radius, rtol=0.05)


def test_the_crop_of_the_second_pass_is_enlarged() -> None:
    image, view = image_with_dots()
    model = DotModel()
    pass_twice(image, view, model, peaks(view.to_working(np.array(BALLS[:2])), view.median_radius, 0.9))
    [(height, width)] = model.input_sizes
    assert view.median_radius < ENLARGED_RADIUS_PX
    assert height * width < 0.3 * view.radius.size


def test_unexplained_foreground_beside_a_ball_gets_a_second_pass() -> None:
    """The network missed one of two touching balls."""
    image, view = image_with_dots()
    model = DotModel()
    detections = pass_twice(image, view, model, peaks(view.to_working(np.array(BALLS[:1])), view.median_radius, 0.9))
    truth = view.to_working(np.array(BALLS[:2]))
    assert np.linalg.norm(detections.centre[:, None] - truth[None], axis=-1).min(axis=0).max() < 0.3


def test_lone_balls_get_one_pass() -> None:
    view, model = image_with_dots()[1], DotModel()
    candidates = peaks(view.to_working(np.array(BALLS)[[0, 2]]), view.median_radius, 0.9)
    lonely = render_balls([Ball(*BALLS[0]), Ball(*BALLS[2])], np.random.default_rng(1))
    detections = pass_twice(lonely, view, model, candidates)
    assert model.input_sizes == []
    assert np.array_equal(detections.centre, candidates.centre)


@pytest.mark.parametrize(("side", "passes"), [((10, 5), 2), ((8, 4), 1)])
def test_foreground_as_large_as_a_fifth_of_a_ball_may_be_one(side: tuple[int, int], passes: int) -> None:
    """The rest of a ball behind another one, and a piece of chalk."""
    image = render_balls([Ball(*BALLS[0])], np.random.default_rng(1), noise=0.0)
    (x, y), (height, width) = BALLS[0], side
    left, top = int(x + 1.3 * RADIUS_PX), int(y - height // 2)
    image[top : top + height, left : left + width] = (235, 230, 225)
    view, model = build_view(build_test_scene()), DotModel()
    candidates = peaks(view.to_working(np.array(BALLS[:1])), view.median_radius, 0.9)
    pass_twice(image, view, model, candidates)
    assert len(model.input_sizes) == passes - 1
