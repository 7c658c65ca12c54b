from __future__ import annotations

import numpy as np
from support.rendered_balls import Ball, draw, drawn_scene

from detectors.hough.hough_detector import ball_finder
from detectors.measurement.frame_change import Memory, touched_places, windows
from models.core.detections import Detections

REST = [Ball(150.2, 150.7), Ball(300.6, 90.3, (200, 30, 40)), Ball(480.1, 200.4, (240, 190, 30))]


def nearest(found: Detections, x: float, y: float) -> np.ndarray:
    offsets: np.ndarray = found.centre - [x, y]
    best: np.ndarray = offsets[np.argmin(np.linalg.norm(offsets, axis=1))]
    return best


def clip(count: int) -> tuple[list[Ball], list[np.ndarray]]:
    """A ball that sets out after three pictures, 5 px per picture, among three at rest; every picture has own noise."""
    rng = np.random.default_rng(21)
    moving = [Ball(200.3 + 5 * max(0, k - 3), 240.8, (235, 235, 225)) for k in range(count)]
    return moving, [draw([*REST, ball], rng) for ball in moving]


def test_following_a_clip_finds_what_looking_at_every_picture_finds() -> None:
    moving, pictures = clip(12)
    finder = ball_finder(drawn_scene(), list(enumerate(pictures)))
    memory: Memory | None = None
    for frame, rgb in enumerate(pictures):
        found, memory = finder.follow(rgb, frame, memory)
        assert len(found) == len(REST) + 1
        for ball in [*REST, moving[frame]]:
            assert np.linalg.norm(nearest(found, ball.x, ball.y)) < 0.7


def test_balls_at_rest_are_measured_in_every_picture() -> None:
    _, pictures = clip(6)
    finder = ball_finder(drawn_scene(), list(enumerate(pictures)))
    memory: Memory | None = None
    places = []
    for frame, rgb in enumerate(pictures):
        found, memory = finder.follow(rgb, frame, memory)
        places.append(tuple(nearest(found, REST[1].x, REST[1].y)))
    assert len(set(places)) == len(pictures)


def test_a_ball_that_is_taken_away_is_not_remembered() -> None:
    rng = np.random.default_rng(22)
    before, after = draw(REST, rng), draw(REST[:2], rng)
    finder = ball_finder(drawn_scene(), [(0, before)])
    found, memory = finder.follow(before, 0, None)
    assert len(found) == 3
    found, memory = finder.follow(after, 1, memory)
    assert len(found) == 2
    assert len(memory.home) == 2


def test_only_what_changed_is_searched() -> None:
    _, pictures = clip(5)
    finder = ball_finder(drawn_scene(), list(enumerate(pictures)))
    view, threshold = finder.view, finder.cloth.threshold
    _, memory = finder.follow(pictures[3], 3, None)
    touched = touched_places(memory, view.picture(pictures[4], 4), view, threshold)
    assert 0 < touched.mean() < 0.1
    spot = view.to_working(np.array([205.3, 240.8])).round().astype(int)
    assert touched[spot[1], spot[0]]
    parts = windows(touched, view)
    assert any(r.start < spot[1] < r.stop and c.start < spot[0] < c.stop for r, c in parts)
    assert sum((r.stop - r.start) * (c.stop - c.start) for r, c in parts) < 0.5 * touched.size


def test_a_window_is_a_view_of_the_same_table() -> None:
    view = ball_finder(drawn_scene(), [(0, clip(1)[1][0])]).view
    part = view.window((slice(20, 120), slice(48, 200)))
    assert part.radius.shape == (100, 152)
    assert np.allclose(part.to_picture(np.array([3.0, 5.0])), view.to_picture(np.array([51.0, 25.0])))


def test_a_ball_whose_outline_is_disturbed_has_a_larger_error() -> None:
    rng = np.random.default_rng(23)
    clean = draw(REST, rng)
    shaded = clean.copy()
    shaded[205:212, 470:492] = 20
    finder = ball_finder(drawn_scene(), [(0, clean)])
    x, y = REST[2].x, REST[2].y
    sigmas = []
    for picture in (clean, shaded):
        found = finder.look(picture)
        row = np.argmin(np.linalg.norm(found.centre - [x, y], axis=1))
        sigmas.append(found.sigma[row])
    assert sigmas[1] > 1.2 * sigmas[0]
