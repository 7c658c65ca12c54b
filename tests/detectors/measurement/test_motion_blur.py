"""The motion-blur model, on rendered tables whose streaks are averages of single discs."""

from __future__ import annotations

import numpy as np
import pytest
from support.rendered_balls import PX_PER_M, RADIUS, Ball, build_test_scene, render_balls

from detectors.measurement.motion_blur import MotionBlurFit, exposure_share, fit_motion_blur
from detectors.measurement.working_view import build_view
from detectors.network.ball_model import SHIPPED_BALL_MODEL, open_ball_model
from detectors.network.network_detector import NetworkDetector, build_network_detector
from detectors.network.peak_decoding import CandidateDetections

RADIUS_PX = RADIUS * PX_PER_M
COLOURS = ((230, 230, 220), (200, 30, 40), (240, 190, 30), (120, 40, 130))
SEEDS = range(12)


class FixedCandidateModel:
    """A network that finds the same ball in every image, px of its input."""

    def __init__(self, centre: tuple[float, float], streak: tuple[float, float]) -> None:
        at, displacement, one = np.array([centre]), np.array([streak]), np.ones(1)
        self.candidates = CandidateDetections(
            at, RADIUS_PX * one, displacement, 0.9 * one, 3.0 * one, 3.0 * one, np.full((1, 4), np.nan)
        )

    def find_candidates(self, rgb: np.ndarray, radius: float) -> CandidateDetections:
        return self.candidates


def render_moving_ball(seed: int) -> tuple[Ball, np.ndarray, np.ndarray]:
    """One moving ball, an image of it, and a place on its streak as a rough position."""
    rng = np.random.default_rng(seed)
    length, angle = rng.uniform(12, 50), rng.uniform(0, np.pi)
    displacement = length * np.array([np.cos(angle), np.sin(angle)])
    ball = Ball(
        *rng.uniform((200, 130), (440, 230)),
        COLOURS[seed % len(COLOURS)],
        (float(displacement[0]), float(displacement[1])),
    )
    return ball, render_balls([ball], rng), np.array([ball.x, ball.y]) + rng.uniform(-0.4, 0.4) * displacement


def detector_with_candidate(centre: tuple[float, float], streak: tuple[float, float]) -> NetworkDetector:
    """A detector on the rendered table whose network finds one ball, px of the image."""
    scene, empty = build_test_scene(), render_balls([], np.random.default_rng(0))
    left, top = build_view(scene).box[:2]
    return build_network_detector(scene, [(0, empty)], FixedCandidateModel((centre[0] - left, centre[1] - top), streak))


def fit_streak(image: np.ndarray, start: np.ndarray) -> MotionBlurFit | None:
    return fit_motion_blur(image, start, RADIUS_PX, np.empty((0, 2)), np.empty(0), np.eye(3))


def test_the_share_is_the_average_of_single_discs() -> None:
    x, y = np.meshgrid(np.arange(80.0), np.arange(60.0))
    at, centre, displacement = np.stack([x, y], axis=-1), np.array([40.3, 29.1]), np.array([21.0, 9.0])
    moments = centre + np.linspace(-0.5, 0.5, 2001)[:, None] * displacement
    counted = np.mean([np.linalg.norm(at - place, axis=-1) < 8.0 for place in moments], axis=0)
    assert np.abs(exposure_share(at, centre, displacement, 8.0, blur=0.0) - counted).max() < 0.01


def test_a_streak_is_placed_within_a_pixel_along_and_across() -> None:
    across, along = [], []
    for seed in SEEDS:
        ball, image, start = render_moving_ball(seed)
        fit = fit_streak(image, start)
        assert fit is not None
        assert fit.is_streak(RADIUS_PX)
        unit = np.array(ball.streak) / np.hypot(*ball.streak)
        miss = fit.centre - (ball.x, ball.y)
        along.append(miss @ unit)
        across.append(miss @ (-unit[1], unit[0]))
        assert abs(np.linalg.norm(fit.displacement) - np.hypot(*ball.streak)) < 0.1 * np.hypot(*ball.streak) + 1
        assert abs(fit.displacement @ unit) > 0.99 * np.linalg.norm(fit.displacement)
    assert np.sqrt(np.mean(np.square(along))) < 1.0
    assert np.sqrt(np.mean(np.square(across))) < 0.5


@pytest.mark.parametrize(("gap", "is_fitted"), [(0.0, False), (15.0, True), (17.0, True), (22.0, False)])
def test_balls_at_rest_are_no_streak(gap: float, is_fitted: bool) -> None:
    """Two balls that nearly touch are fitted as one long shape, and then rejected by its form."""
    rng = np.random.default_rng(5)
    balls = [Ball(300.0, 180.0, COLOURS[0])]
    if gap:
        balls.append(Ball(300.0 + gap, 182.0, COLOURS[1]))
    fit = fit_streak(render_balls(balls, rng), np.array([301.0, 180.5]))
    assert (fit is not None) == is_fitted
    assert fit is None or not fit.is_streak(RADIUS_PX)


def test_the_detector_measures_how_far_a_fast_ball_moved() -> None:
    rng = np.random.default_rng(8)
    resting = [Ball(120.0, 90.0, COLOURS[1]), Ball(520.0, 260.0, COLOURS[2])]
    fast = Ball(330.3, 275.6, (235, 235, 225), (20.0, -15.0))
    detector = build_network_detector(
        build_test_scene(), [(0, render_balls(resting, rng))], open_ball_model(SHIPPED_BALL_MODEL)
    )
    detections = detector.detect(render_balls([*resting, fast], rng))
    assert len(detections) == 3
    moving = int(np.argmax(np.linalg.norm(detections.streak, axis=1)))
    assert np.linalg.norm(detections.centre[moving] - (fast.x, fast.y)) < 1.0
    assert abs(np.linalg.norm(detections.streak[moving]) - np.hypot(*fast.streak)) < 3.0
    assert (np.linalg.norm(np.delete(detections.streak, moving, axis=0), axis=1) == 0).all()


def test_a_streak_that_the_network_finds_is_measured() -> None:
    fast = Ball(330.3, 225.6, (235, 235, 225), (20.0, -15.0))
    image = render_balls([fast], np.random.default_rng(8))
    detector = detector_with_candidate((fast.x + 4.0, fast.y), (26.0, -10.0))
    [centre], [streak] = (getattr(detector.detect(image), name) for name in ("centre", "streak"))
    assert np.linalg.norm(centre - (fast.x, fast.y)) < 1.0
    assert abs(streak @ fast.streak) == pytest.approx(np.hypot(*fast.streak) ** 2, rel=0.15)


def test_a_streak_that_the_image_does_not_show_stays_about_where_the_network_found_it() -> None:
    image = render_balls([], np.random.default_rng(8))
    detections = detector_with_candidate((330.0, 225.0), (26.0, -10.0)).detect(image)
    assert detections.centre[0] == pytest.approx((330.0, 225.0), abs=2.0)
    assert detections.sigma_along[0] > 2.0


def test_a_ball_at_rest_does_not_move_because_of_the_network_alone() -> None:
    resting = Ball(330.3, 225.6)
    detections = detector_with_candidate((resting.x + 1.5, resting.y - 1.0), (6.0, 0.0)).detect(
        render_balls([resting], np.random.default_rng(8))
    )
    assert np.linalg.norm(detections.centre[0] - (resting.x, resting.y)) < 0.5
    assert (detections.streak == 0).all()


@pytest.mark.parametrize(
    ("left", "left_at_rest", "length", "is_streak"),
    [
        (0.12, 0.28, 2.0, True),  # a moving ball leaves less than half of what one at rest leaves
        (0.12, 0.20, 2.0, False),  # the motion explains little that a ball at rest does not
        (0.13, 1.0, 2.0, True),
        (0.18, 1.0, 2.0, False),  # something else is in the image
        (0.05, 1.0, 0.9, True),
        (0.05, 1.0, 0.7, False),  # hardly longer than the blur of an outline
        (0.05, 1.0, 6.5, True),
        (0.05, 1.0, 8.5, False),  # a cue
    ],
)
def test_a_streak_is_what_a_moving_ball_explains_far_better_than_one_at_rest(
    left: float, left_at_rest: float, length: float, is_streak: bool
) -> None:
    displacement = np.array([0.6, 0.8]) * length * RADIUS_PX
    assert MotionBlurFit(np.zeros(2), displacement, left, left_at_rest).is_streak(RADIUS_PX) == is_streak
