"""The upright crop window stays inside the frame, moves smoothly and contains the moving ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support import staged_shot as shot

from video.matting.ball_timeline import build_ball_timeline
from video.overlay.plain_interpolation import window_left_borders, window_width

TIMES = np.arange(31) / shot.RATE


def test_the_window_has_the_shape_of_an_upright_screen() -> None:
    assert window_width(1280, 720) == 404
    assert window_width(300, 720) == 300


def test_the_window_follows_the_moving_ball_smoothly_and_stays_in_the_frame() -> None:
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    fine = np.linspace(0, 1, 241)
    lefts, width = window_left_borders(timeline, fine), window_width(shot.WIDTH, shot.HEIGHT)
    balls = np.array([shot.place(t)[0, 0] * shot.SCALE + shot.MARGIN for t in fine])
    assert (lefts >= 0).all()
    assert (lefts + width <= shot.WIDTH).all()
    inside = (balls > lefts) & (balls < lefts + width)
    assert inside.mean() > 0.95
    assert np.abs(np.diff(lefts)).max() <= 2, "no jump"
    assert lefts[-1] > lefts[0]


def test_without_motion_the_window_is_centred_on_the_balls() -> None:
    timeline = build_ball_timeline(shot.scene(), shot.tracks(TIMES), shot.fit(TIMES))
    resting = shot.fit(TIMES).trajectory.position.copy()
    resting[:, 1:] = 0
    still = replace(timeline, trajectory=replace(timeline.trajectory, position=resting))
    assert len(np.unique(window_left_borders(still, TIMES))) == 1
