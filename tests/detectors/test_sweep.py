"""Streaks as exposure integrals, on drawn tables whose streaks are made another way: discs averaged one by one."""

from __future__ import annotations

import numpy as np
import pytest
from support.rendered_balls import PX_PER_M, RADIUS, Ball, draw, drawn_scene

from detectors.measurement.motion_blur import Sweep, fitted_sweep, share_covered
from detectors.measurement.working_view import view_of
from detectors.network.network_detector import NetworkFinder, network_finder
from detectors.network.network_file import SHIPPED, open_model
from detectors.network.peak_decoding import Centres

RADIUS_PX = RADIUS * PX_PER_M
COLOURS = ((230, 230, 220), (200, 30, 40), (240, 190, 30), (120, 40, 130))
SEEDS = range(12)


class Told:
    """A network that sees the same ball in every picture, px of the part that it is shown."""

    def __init__(self, centre: tuple[float, float], streak: tuple[float, float]) -> None:
        at, way, one = np.array([centre]), np.array([streak]), np.ones(1)
        self.word = Centres(at, RADIUS_PX * one, way, 0.9 * one, 3.0 * one, 3.0 * one, np.full((1, 4), np.nan))

    def see(self, rgb: np.ndarray, radius: float) -> Centres:
        return self.word


def alone(seed: int) -> tuple[Ball, np.ndarray, np.ndarray]:
    """One moving ball, a picture of it, and a place on its streak where a detector may have seen it."""
    rng = np.random.default_rng(seed)
    length, angle = rng.uniform(12, 50), rng.uniform(0, np.pi)
    way = length * np.array([np.cos(angle), np.sin(angle)])
    ball = Ball(*rng.uniform((200, 130), (440, 230)), COLOURS[seed % len(COLOURS)], (float(way[0]), float(way[1])))
    return ball, draw([ball], rng), np.array([ball.x, ball.y]) + rng.uniform(-0.4, 0.4) * way


def finder_told(centre: tuple[float, float], streak: tuple[float, float]) -> NetworkFinder:
    """A finder on the drawn table whose network sees one ball, px of the picture."""
    scene, empty = drawn_scene(), draw([], np.random.default_rng(0))
    left, top = view_of(scene).box[:2]
    return network_finder(scene, [(0, empty)], Told((centre[0] - left, centre[1] - top), streak))


def sweep_of(picture: np.ndarray, seen: np.ndarray) -> Sweep | None:
    return fitted_sweep(picture, seen, RADIUS_PX, np.empty((0, 2)), np.empty(0), np.eye(3))


def test_the_share_is_what_discs_one_after_another_add_up_to() -> None:
    x, y = np.meshgrid(np.arange(80.0), np.arange(60.0))
    at, centre, way = np.stack([x, y], axis=-1), np.array([40.3, 29.1]), np.array([21.0, 9.0])
    moments = centre + np.linspace(-0.5, 0.5, 2001)[:, None] * way
    counted = np.mean([np.linalg.norm(at - place, axis=-1) < 8.0 for place in moments], axis=0)
    assert np.abs(share_covered(at, centre, way, 8.0, blur=0.0) - counted).max() < 0.01


def test_a_streak_is_placed_within_a_pixel_along_and_across_and_its_errors_are_honest() -> None:
    across, along = [], []
    for seed in SEEDS:
        ball, picture, seen = alone(seed)
        sweep = sweep_of(picture, seen)
        assert sweep is not None
        assert sweep.believed(RADIUS_PX)
        unit = np.array(ball.streak) / np.hypot(*ball.streak)
        miss = sweep.centre - (ball.x, ball.y)
        along.append(miss @ unit)
        across.append(miss @ (-unit[1], unit[0]))
        assert abs(np.linalg.norm(sweep.way) - np.hypot(*ball.streak)) < 0.1 * np.hypot(*ball.streak) + 1
        assert abs(sweep.way @ unit) > 0.99 * np.linalg.norm(sweep.way)
    assert np.sqrt(np.mean(np.square(along))) < 1.0
    assert np.sqrt(np.mean(np.square(across))) < 0.5


@pytest.mark.parametrize("gap", [0.0, 15.0, 17.0, 22.0])
def test_balls_at_rest_are_no_streak(gap: float) -> None:
    rng = np.random.default_rng(5)
    balls = [Ball(300.0, 180.0, COLOURS[0])]
    if gap:
        balls.append(Ball(300.0 + gap, 182.0, COLOURS[1]))
    sweep = sweep_of(draw(balls, rng), np.array([301.0, 180.5]))
    assert sweep is None or not sweep.believed(RADIUS_PX)


def test_the_finder_says_how_far_a_fast_ball_went() -> None:
    rng = np.random.default_rng(8)
    resting = [Ball(120.0, 90.0, COLOURS[1]), Ball(520.0, 260.0, COLOURS[2])]
    fast = Ball(330.3, 275.6, (235, 235, 225), (20.0, -15.0))
    finder = network_finder(drawn_scene(), [(0, draw(resting, rng))], open_model(SHIPPED))
    found = finder.look(draw([*resting, fast], rng))
    assert len(found) == 3
    moving = int(np.argmax(np.linalg.norm(found.streak, axis=1)))
    assert np.linalg.norm(found.centre[moving] - (fast.x, fast.y)) < 1.0
    assert abs(np.linalg.norm(found.streak[moving]) - np.hypot(*fast.streak)) < 3.0
    assert (np.linalg.norm(np.delete(found.streak, moving, axis=0), axis=1) == 0).all()


def test_a_streak_that_the_network_sees_is_measured() -> None:
    fast = Ball(330.3, 225.6, (235, 235, 225), (20.0, -15.0))
    picture = draw([fast], np.random.default_rng(8))
    finder = finder_told((fast.x + 4.0, fast.y), (26.0, -10.0))
    [centre], [streak] = (getattr(finder.look(picture), name) for name in ("centre", "streak"))
    assert np.linalg.norm(centre - (fast.x, fast.y)) < 1.0
    assert abs(streak @ fast.streak) == pytest.approx(np.hypot(*fast.streak) ** 2, rel=0.15)


def test_a_streak_that_the_picture_does_not_show_stays_about_where_the_network_saw_it() -> None:
    picture = draw([], np.random.default_rng(8))
    told = finder_told((330.0, 225.0), (26.0, -10.0)).look(picture)
    assert told.centre[0] == pytest.approx((330.0, 225.0), abs=2.0)
    assert told.sigma_along[0] > 2.0


def test_a_ball_at_rest_is_none_that_moved_because_the_network_says_so() -> None:
    resting = Ball(330.3, 225.6)
    found = finder_told((resting.x + 1.5, resting.y - 1.0), (6.0, 0.0)).look(draw([resting], np.random.default_rng(8)))
    assert np.linalg.norm(found.centre[0] - (resting.x, resting.y)) < 0.5
    assert (found.streak == 0).all()
