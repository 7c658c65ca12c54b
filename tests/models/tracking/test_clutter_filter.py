"""What moves like a ball: its velocity changes at contacts only."""

from __future__ import annotations

import numpy as np
import pytest
from support.tracking_shots import POOL, R, overhead

from models.core.detections import Detections
from models.tracking.clutter_filter import moves_like_ball
from models.tracking.table_detections import project_detections
from models.tracking.tracklet_linking import make_tracklet

SPEED, FPS = 2.0, 30


@pytest.mark.parametrize(
    ("frames", "turns", "is_ball"),
    [
        (16, 3, True),  # three cushions in half a second
        (13, 3, False),
        (24, 4, True),
        (18, 4, False),
    ],
)
def test_an_object_that_turns_more_often_than_a_ball_meets_cushions_is_none(
    frames: int, turns: int, is_ball: bool
) -> None:
    t, scene = np.arange(frames) / FPS, overhead()
    corners = np.linspace(0, frames - 1, turns + 2).round().astype(int)[1:-1]
    upwards = np.searchsorted(corners, np.arange(frames - 1), side="right") % 2 == 0
    steps = np.where(upwards[:, None], [1.0, 1.0], [1.0, -1.0]) * SPEED / FPS / np.sqrt(2)
    xy = np.array([0.5, 0.5]) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    one, px = np.ones(frames), scene.camera.to_pixels(xy, R)
    coat = (np.full((frames, 3), 60.0), 0.1 * one, 0.1 * one, 0.6 * one)
    image = Detections(np.arange(frames), px, 11.4 * one, 0 * px, *coat, one, 0.5 * one, 0.5 * one)
    detections = project_detections(image, np.arange(frames), scene)
    tracklet = make_tracklet(np.arange(frames), np.arange(frames), detections, t)
    assert moves_like_ball(tracklet, [], detections, t, POOL) == is_ball
