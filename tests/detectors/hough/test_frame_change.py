from __future__ import annotations

import numpy as np
from support.rendered_balls import Ball, build_test_scene, render_balls

from detectors.hough.hough_detector import build_hough_detector
from detectors.measurement.frame_change import SearchMemory, find_touched_places, find_windows
from models.core.detections import Detections

REST = [Ball(150.2, 150.7), Ball(300.6, 90.3, (200, 30, 40)), Ball(480.1, 200.4, (240, 190, 30))]


def nearest(detections: Detections, x: float, y: float) -> np.ndarray:
    offsets: np.ndarray = detections.centre - [x, y]
    best: np.ndarray = offsets[np.argmin(np.linalg.norm(offsets, axis=1))]
    return best


def clip(count: int) -> tuple[list[Ball], list[np.ndarray]]:
    """A ball that starts after three frames, 5 px per frame, among three at rest; every image has its own noise."""
    rng = np.random.default_rng(21)
    moving = [Ball(200.3 + 5 * max(0, k - 3), 240.8, (235, 235, 225)) for k in range(count)]
    return moving, [render_balls([*REST, ball], rng) for ball in moving]


def test_following_a_clip_detects_what_searching_every_frame_detects() -> None:
    moving, images = clip(12)
    detector = build_hough_detector(build_test_scene(), list(enumerate(images)))
    memory: SearchMemory | None = None
    for frame, rgb in enumerate(images):
        detections, memory = detector.detect_next(rgb, frame, memory)
        assert len(detections) == len(REST) + 1
        for ball in [*REST, moving[frame]]:
            assert np.linalg.norm(nearest(detections, ball.x, ball.y)) < 0.7


def test_balls_at_rest_are_measured_in_every_frame() -> None:
    _, images = clip(6)
    detector = build_hough_detector(build_test_scene(), list(enumerate(images)))
    memory: SearchMemory | None = None
    places = []
    for frame, rgb in enumerate(images):
        detections, memory = detector.detect_next(rgb, frame, memory)
        places.append(tuple(nearest(detections, REST[1].x, REST[1].y)))
    assert len(set(places)) == len(images)


def test_a_ball_that_is_taken_away_is_not_remembered() -> None:
    rng = np.random.default_rng(22)
    before, after = render_balls(REST, rng), render_balls(REST[:2], rng)
    detector = build_hough_detector(build_test_scene(), [(0, before)])
    detections, memory = detector.detect_next(before, 0, None)
    assert len(detections) == 3
    detections, memory = detector.detect_next(after, 1, memory)
    assert len(detections) == 2
    assert len(memory.working_centre) == 2


def test_only_what_changed_is_searched() -> None:
    _, images = clip(5)
    detector = build_hough_detector(build_test_scene(), list(enumerate(images)))
    view, threshold = detector.view, detector.cloth.threshold
    _, memory = detector.detect_next(images[3], 3, None)
    touched = find_touched_places(memory, view.working_image(images[4], 4), view, threshold)
    assert 0 < touched.mean() < 0.1
    spot = view.to_working(np.array([205.3, 240.8])).round().astype(int)
    assert touched[spot[1], spot[0]]
    parts = find_windows(touched, view)
    assert any(r.start < spot[1] < r.stop and c.start < spot[0] < c.stop for r, c in parts)
    assert sum((r.stop - r.start) * (c.stop - c.start) for r, c in parts) < 0.5 * touched.size


def test_a_ball_whose_outline_is_disturbed_has_a_larger_error() -> None:
    rng = np.random.default_rng(23)
    clean = render_balls(REST, rng)
    shaded = clean.copy()
    shaded[205:212, 470:492] = 20
    detector = build_hough_detector(build_test_scene(), [(0, clean)])
    x, y = REST[2].x, REST[2].y
    sigmas = []
    for image in (clean, shaded):
        detections = detector.detect(image)
        row = np.argmin(np.linalg.norm(detections.centre - [x, y], axis=1))
        sigmas.append(detections.sigma[row])
    assert sigmas[1] > 1.2 * sigmas[0]
