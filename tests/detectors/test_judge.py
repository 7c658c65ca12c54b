"""What becomes of what a network saw: balls, where the picture bears it out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.rendered_balls import PX_PER_M, RADIUS, Ball, draw, drawn_scene, spread_balls

from detectors.measurement.cloth_background import learn_cloth
from detectors.measurement.working_view import view_of
from detectors.network.disc_regressor import open_disc_model
from detectors.network.peak_decoding import LOOKS, Centres
from detectors.network.postprocessing import CLEAR_SCORE, FAINT_SCORE, LEAST_SCORE, Judge
from detectors.network.streak_regressor import open_streak_model

SIZE_PX = RADIUS * PX_PER_M
WHITE, BLUE, PALE = (235.0, 235.0, 225.0), (30.0, 60.0, 200.0), (52.0, 135.0, 185.0)


def judge_of(picture: np.ndarray) -> Judge:
    view = view_of(drawn_scene())
    return Judge(view, learn_cloth([view.picture(picture)], view), open_streak_model(), open_disc_model())


def seen(judge: Judge, *balls: tuple[float, float, float, tuple[float, float], float]) -> Centres:
    """Peaks at px of the picture: x, y, radius over a ball's, streak px, score."""
    centre = judge.view.to_working(np.array([[x, y] for x, y, *_ in balls]))
    scale, count = judge.view.scale, len(balls)
    sigma = np.full(count, 0.6 * scale)
    return Centres(
        centre,
        np.array([SIZE_PX * scale * relative for _, _, relative, _, _ in balls]),
        np.array([streak for *_, streak, _ in balls]) * scale,
        np.array([score for *_, score in balls]),
        sigma,
        sigma,
        np.full((count, len(LOOKS)), 1 / len(LOOKS)),
    )


@pytest.mark.parametrize("turn", range(4))
def test_a_ball_of_which_only_a_mark_is_seen_is_found_whole(turn: int) -> None:
    """A white patch off the middle of a dark ball has the clearer outline of the two."""
    ball, angle = Ball(301.4, 170.7, BLUE), np.pi / 2 * turn
    picture = draw([ball], np.random.default_rng(1))
    at = np.array([ball.x, ball.y]) + 0.5 * SIZE_PX * np.array([np.cos(angle), np.sin(angle)])
    centre = tuple(int(c) for c in np.rint(16 * at))
    cv2.circle(picture, centre, round(16 * 0.6 * SIZE_PX), WHITE, -1, cv2.LINE_AA, 4)
    judge = judge_of(picture)
    found = judge.measured(picture, seen(judge, (float(at[0]), float(at[1]), 0.6, (0.0, 0.0), 0.9)), 0).balls
    assert len(found) == 1
    assert np.linalg.norm(found.centre[0] - (ball.x, ball.y)) < 0.8
    assert found.radius[0] == pytest.approx(SIZE_PX, rel=0.1)


def test_a_mark_on_the_cloth_is_no_ball() -> None:
    rng = np.random.default_rng(2)
    picture = draw(spread_balls(rng, (WHITE, BLUE), 3), rng)
    picture[168:174, 298:304] = (20, 20, 20)
    judge = judge_of(picture)
    judged = judge.measured(picture, seen(judge, (300.5, 170.5, 0.55, (0.0, 0.0), 0.95)), 0)
    assert len(judged.balls) == 0
    assert judged.refuted.tolist() == [True]


@pytest.mark.parametrize(("size", "balls"), [(0.68, 0), (0.9, 1)])
def test_a_spot_that_the_network_takes_for_a_small_ball_is_none(size: float, balls: int) -> None:
    rng = np.random.default_rng(7)
    picture = draw(spread_balls(rng, (WHITE, BLUE), 3), rng)
    cv2.circle(picture, (16 * 300, 16 * 250), round(16 * size * SIZE_PX), (20, 20, 20), -1, cv2.LINE_AA, 4)
    judge = judge_of(picture)
    found = judge.measured(picture, seen(judge, (300.3, 250.2, size, (0.0, 0.0), 0.95)), 0).balls
    assert len(found) == balls


def test_a_faint_streak_is_a_ball_where_the_picture_adds_up_to_one() -> None:
    ball = Ball(330.3, 175.6, WHITE, (24.0, 7.0))
    picture = draw([ball], np.random.default_rng(3))
    judge = judge_of(picture)
    faint = (FAINT_SCORE + LEAST_SCORE) / 2
    there, away = (ball.x + 2, ball.y + 1, 1.0, (20.0, 8.0), faint), (200.0, 250.0, 1.0, (20.0, 8.0), faint)
    found = judge.measured(picture, seen(judge, there, away), 0).balls
    assert len(found) == 1
    assert np.linalg.norm(found.centre[0] - (ball.x, ball.y)) < 1.0
    assert np.abs(np.abs(found.streak[0]) - np.abs(ball.streak)).max() < 2.5


def test_a_streak_takes_no_ball_away_that_is_sure_or_surer_than_itself() -> None:
    """The ball is nearly of the cloth's colour: its outline alone would not keep it."""
    ball = Ball(300.0, 170.0, PALE)
    picture = draw([ball], np.random.default_rng(4), noise=6.0)
    judge = judge_of(picture)
    for score, streak_score, kept in ((0.95, CLEAR_SCORE, True), (0.8, 0.95, True), (0.5, CLEAR_SCORE, False)):
        streak = (ball.x + 2.2 * SIZE_PX, ball.y + 3.0, 1.0, (4.0 * SIZE_PX, 0.0), streak_score)
        found = judge.measured(picture, seen(judge, (ball.x, ball.y, 1.0, (0.0, 0.0), score), streak), 0).balls
        assert bool((np.linalg.norm(found.streak, axis=1) == 0).any()) is kept


def test_a_ball_before_a_streak_is_not_the_streak() -> None:
    """Its outline is broken, and an exposure that goes by beneath it explains the picture about it."""
    moving = Ball(330.0, 172.0, WHITE, (4.5 * SIZE_PX, 0.0))
    ball = Ball(moving.x + 1.7 * SIZE_PX, moving.y + 1.2 * SIZE_PX, PALE)
    picture = cv2.GaussianBlur(draw([moving, ball], np.random.default_rng(6)), (0, 0), 2.0)
    judge = judge_of(picture)
    streak = (moving.x, moving.y, 1.0, moving.streak, 0.95)
    found = judge.measured(picture, seen(judge, streak, (ball.x, ball.y, 1.0, (0.0, 0.0), 0.8)), 0).balls
    rests = np.linalg.norm(found.streak, axis=1) == 0
    assert rests.tolist() == [False, True]
    assert np.linalg.norm(found.centre[rests] - (ball.x, ball.y)) < 0.4 * SIZE_PX


def test_a_row_of_balls_that_the_network_is_sure_of_is_no_streak() -> None:
    """Balls of one colour that touch add up to what a ball leaves that moves by; their outlines are broken."""
    step = 2 * SIZE_PX
    row = [Ball(280.0 + k * step, 170.0, WHITE) for k in range(4)]
    picture = cv2.GaussianBlur(draw(row, np.random.default_rng(5)), (0, 0), 2.5)
    judge = judge_of(picture)
    judged = judge.measured(picture, seen(judge, *((b.x, b.y, 1.0, (0.0, 0.0), 0.95) for b in row)), 0)
    assert len(judged.balls) == 4
    assert not judged.balls.streak.any()
    assert not judged.refuted.any()
    gap = np.abs(judged.balls.centre[:, None] - np.array([[b.x, b.y] for b in row])).max(axis=2).min(axis=0)
    assert gap.max() < 0.4 * SIZE_PX
