"""Post-processing of candidate detections: balls where the image confirms them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.rendered_balls import PX_PER_M, RADIUS, Ball, build_test_scene, render_balls, spread_balls

from detectors.measurement.cloth_background import learn_cloth_background
from detectors.measurement.working_view import build_view
from detectors.network.candidate_rules import CLEAR_SCORE, FAINT_SCORE, REPORTED_SCORE
from detectors.network.network_detector import PostProcessingResult, PostProcessor
from detectors.network.offset_regressor import DISC, STREAK, open_offset_regressor
from detectors.network.peak_decoding import APPEARANCES, CandidateDetections

SIZE_PX = RADIUS * PX_PER_M
WHITE, BLUE, PALE = (235.0, 235.0, 225.0), (30.0, 60.0, 200.0), (52.0, 135.0, 185.0)


def build_post_processor(image: np.ndarray) -> PostProcessor:
    view = build_view(build_test_scene())
    cloth = learn_cloth_background([view.working_image(image)], view)
    return PostProcessor(view, cloth, open_offset_regressor(STREAK), open_offset_regressor(DISC))


def candidates_at(
    processor: PostProcessor, *balls: tuple[float, float, float, tuple[float, float], float]
) -> CandidateDetections:
    """Candidates: x and y px of the image, radius over that of a ball, streak px, score."""
    centre = processor.view.to_working(np.array([[x, y] for x, y, *_ in balls]))
    scale, count = processor.view.scale, len(balls)
    sigma = np.full(count, 0.6 * scale)
    return CandidateDetections(
        centre,
        np.array([SIZE_PX * scale * relative for _, _, relative, _, _ in balls]),
        np.array([streak for *_, streak, _ in balls]) * scale,
        np.array([score for *_, score in balls]),
        sigma,
        sigma,
        np.full((count, len(APPEARANCES)), 1 / len(APPEARANCES)),
    )


def process(
    processor: PostProcessor, image: np.ndarray, *balls: tuple[float, float, float, tuple[float, float], float]
) -> PostProcessingResult:
    """Process candidates as of `candidates_at` in frame 0."""
    return processor.process_candidates(image, candidates_at(processor, *balls), 0)


@pytest.mark.parametrize("turn", range(4))
def test_a_ball_with_only_a_mark_as_candidate_is_detected_whole(turn: int) -> None:
    """A white patch off the middle of a dark ball has the clearer outline of the two."""
    ball, angle = Ball(301.4, 170.7, BLUE), np.pi / 2 * turn
    image = render_balls([ball], np.random.default_rng(1))
    at = np.array([ball.x, ball.y]) + 0.5 * SIZE_PX * np.array([np.cos(angle), np.sin(angle)])
    centre = tuple(int(c) for c in np.rint(16 * at))
    cv2.circle(image, centre, round(16 * 0.6 * SIZE_PX), WHITE, -1, cv2.LINE_AA, 4)
    processor = build_post_processor(image)
    detections = processor.process_candidates(
        image, candidates_at(processor, (float(at[0]), float(at[1]), 0.6, (0.0, 0.0), 0.9)), 0
    ).detections
    assert len(detections) == 1
    assert np.linalg.norm(detections.centre[0] - (ball.x, ball.y)) < 0.8
    assert detections.radius[0] == pytest.approx(SIZE_PX, rel=0.1)


def test_a_mark_on_the_cloth_is_no_ball() -> None:
    rng = np.random.default_rng(2)
    image = render_balls(spread_balls(rng, (WHITE, BLUE), 3), rng)
    image[168:174, 298:304] = (20, 20, 20)
    processor = build_post_processor(image)
    result = process(processor, image, (300.5, 170.5, 0.55, (0.0, 0.0), 0.95))
    assert len(result.detections) == 0
    assert result.is_rejected.tolist() == [True]


@pytest.mark.parametrize(("size", "balls"), [(0.68, 0), (0.9, 1)])
def test_a_spot_that_the_network_takes_for_a_small_ball_is_none(size: float, balls: int) -> None:
    rng = np.random.default_rng(7)
    image = render_balls(spread_balls(rng, (WHITE, BLUE), 3), rng)
    cv2.circle(image, (16 * 300, 16 * 250), round(16 * size * SIZE_PX), (20, 20, 20), -1, cv2.LINE_AA, 4)
    image[245:249, 297:301] = 130  # it mirrors a lamp, unlike a drawn disc
    image = np.clip(image + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8)
    processor = build_post_processor(image)
    detections = processor.process_candidates(
        image, candidates_at(processor, (300.3, 250.2, size, (0.0, 0.0), 0.95)), 0
    ).detections
    assert len(detections) == balls


def test_a_faint_streak_is_a_ball_where_the_motion_blur_model_explains_the_image() -> None:
    ball = Ball(330.3, 175.6, WHITE, (24.0, 7.0))
    image = render_balls([ball], np.random.default_rng(3))
    processor = build_post_processor(image)
    faint = (FAINT_SCORE + REPORTED_SCORE) / 2
    there, away = (ball.x + 2, ball.y + 1, 1.0, (20.0, 8.0), faint), (200.0, 250.0, 1.0, (20.0, 8.0), faint)
    detections = process(processor, image, there, away).detections
    assert len(detections) == 1
    assert np.linalg.norm(detections.centre[0] - (ball.x, ball.y)) < 1.0
    assert np.abs(np.abs(detections.streak[0]) - np.abs(ball.streak)).max() < 2.5


def test_a_streak_takes_no_ball_away_that_is_sure_or_surer_than_itself() -> None:
    """The ball is nearly of the cloth's colour: its outline alone would not keep it."""
    ball = Ball(300.0, 170.0, PALE)
    image = render_balls([ball], np.random.default_rng(4), noise=6.0)
    processor = build_post_processor(image)
    for score, streak_score, is_kept in ((0.95, CLEAR_SCORE, True), (0.8, 0.95, True), (0.5, CLEAR_SCORE, False)):
        streak = (ball.x + 2.2 * SIZE_PX, ball.y + 3.0, 1.0, (4.0 * SIZE_PX, 0.0), streak_score)
        detections = processor.process_candidates(
            image, candidates_at(processor, (ball.x, ball.y, 1.0, (0.0, 0.0), score), streak), 0
        ).detections
        assert bool((np.linalg.norm(detections.streak, axis=1) == 0).any()) is is_kept


def test_a_ball_before_a_streak_is_not_the_streak() -> None:
    """Its outline is interrupted, and the streak beneath it explains the image around it."""
    moving = Ball(330.0, 172.0, WHITE, (4.5 * SIZE_PX, 0.0))
    ball = Ball(moving.x + 1.7 * SIZE_PX, moving.y + 1.2 * SIZE_PX, PALE)
    image = cv2.GaussianBlur(render_balls([moving, ball], np.random.default_rng(6)), (0, 0), 2.0)
    processor = build_post_processor(image)
    streak = (moving.x, moving.y, 1.0, moving.streak, 0.95)
    detections = processor.process_candidates(
        image, candidates_at(processor, streak, (ball.x, ball.y, 1.0, (0.0, 0.0), 0.8)), 0
    ).detections
    rests = np.linalg.norm(detections.streak, axis=1) == 0
    assert rests.tolist() == [False, True]
    assert np.linalg.norm(detections.centre[rests] - (ball.x, ball.y)) < 0.4 * SIZE_PX


def test_a_row_of_balls_that_the_network_is_sure_of_is_no_streak() -> None:
    """Touching balls of one colour resemble a motion-blur streak, and their outlines are interrupted."""
    step = 2 * SIZE_PX
    row = [Ball(280.0 + k * step, 170.0, WHITE) for k in range(4)]
    image = cv2.GaussianBlur(render_balls(row, np.random.default_rng(5)), (0, 0), 2.5)
    processor = build_post_processor(image)
    result = processor.process_candidates(
        image, candidates_at(processor, *((b.x, b.y, 1.0, (0.0, 0.0), 0.95) for b in row)), 0
    )
    assert len(result.detections) == 4
    assert not result.detections.streak.any()
    assert not result.is_rejected.any()
    gap = np.abs(result.detections.centre[:, None] - np.array([[b.x, b.y] for b in row])).max(axis=2).min(axis=0)
    assert gap.max() < 0.4 * SIZE_PX


@pytest.mark.parametrize(("share", "balls"), [(0.0, 0), (0.5, 0), (0.9, 1)])
def test_a_disc_through_which_the_cloth_shows_is_no_ball(share: float, balls: int) -> None:
    """A ring of light, also over a haze of its own light; a ball is somewhat darker at its rim."""
    rng = np.random.default_rng(8)
    image = render_balls(spread_balls(rng, (WHITE, BLUE), 3), rng)
    processor = build_post_processor(image)
    disc, ring = np.zeros((2, *image.shape[:2]))
    cv2.circle(disc, (16 * 300, 16 * 250), round(16 * SIZE_PX), share, -1, cv2.LINE_8, 4)
    cv2.circle(ring, (16 * 300, 16 * 250), round(16 * 0.85 * SIZE_PX), 1.0, 3, cv2.LINE_8, 4)
    shade = 1 + 0.5 * (np.arange(image.shape[1]) - 300) / SIZE_PX
    lit = image + np.maximum(disc * shade, ring)[..., None] * [60.0, 70.0, 60.0]
    image = np.clip(lit, 0, 255).astype(np.uint8)
    result = process(processor, image, (300.0, 250.0, 1.0, (0.0, 0.0), 0.95))
    assert len(result.detections) == balls


@pytest.mark.parametrize("is_marking", [False, True])
@pytest.mark.parametrize("shape", ["ring", "line"])
def test_a_ring_or_a_line_is_no_ball_also_where_it_is_there_from_the_first(shape: str, is_marking: bool) -> None:
    """What stays in all images is learnt as a marking of the cloth."""
    rng = np.random.default_rng(8)
    plain = render_balls(spread_balls(rng, (WHITE, BLUE), 3), rng)
    image = plain.copy()
    if shape == "ring":
        cv2.circle(image, (16 * 300, 16 * 250), round(16 * 0.85 * SIZE_PX), (230, 240, 235), 3, cv2.LINE_8, 4)
    else:
        cv2.line(image, (250, 230), (350, 270), (255, 40, 40), round(0.7 * SIZE_PX), cv2.LINE_AA)
    processor = build_post_processor(image if is_marking else plain)
    assert not len(process(processor, image, (300.0, 250.0, 1.0, (0.0, 0.0), 0.95)).detections)
