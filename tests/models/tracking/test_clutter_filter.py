"""What moves like a ball: its velocity changes at contacts only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.tracking_shots import POOL, R, overhead

from models.core.detections import Detections
from models.core.typing import FloatArray
from models.tracking.clutter_filter import is_ball, moves_like_ball
from models.tracking.table_detections import TableDetections, project_detections
from models.tracking.tracklet_linking import Tracklet, make_tracklet

SPEED, FPS = 2.0, 30


def observe(*paths: tuple[int, FloatArray]) -> tuple[list[Tracklet], TableDetections, FloatArray]:
    """Detect objects with first frames and places (M, 2) m, without errors."""
    frame = np.concatenate([np.arange(first, first + len(xy)) for first, xy in paths])
    number = np.repeat(np.arange(len(paths)), [len(xy) for _, xy in paths])
    order = np.lexsort((number, frame))
    px = overhead().camera.to_pixels(np.concatenate([xy for _, xy in paths])[order], R)
    one = np.ones(len(px))
    coat = (np.full((len(px), 3), 60.0), 0.1 * one, 0.1 * one, 0.6 * one)
    image = Detections(frame[order], px, 11.4 * one, 0 * px, *coat, one, 0.5 * one, 0.5 * one)
    t = np.arange(frame.max() + 1) / FPS
    detections = project_detections(image, np.arange(len(t)), overhead())
    rows = [np.flatnonzero(number[order] == k) for k in range(len(paths))]
    return [make_tracklet(frame[order][own], own, detections, t) for own in rows], detections, t


def drag(stops: list[tuple[float, float]], frames: int = 12) -> FloatArray:
    """Move evenly from stop to stop (m), `frames` frames each."""
    at = np.arange(frames * (len(stops) - 1) + 1) / frames
    return np.stack([np.interp(at, np.arange(len(stops)), column) for column in np.transpose(stops)], axis=1)


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
    corners = np.linspace(0, frames - 1, turns + 2).round().astype(int)[1:-1]
    upwards = np.searchsorted(corners, np.arange(frames - 1), side="right") % 2 == 0
    steps = np.where(upwards[:, None], [1.0, 1.0], [1.0, -1.0]) * SPEED / FPS / np.sqrt(2)
    table = replace(POOL, width=0.4)  # so narrow that every turn is near a cushion
    xy = np.array([0.5, 0.1]) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    (tracklet,), detections, t = observe((0, xy))
    assert moves_like_ball(tracklet, [], detections, t, table) == is_ball


@pytest.mark.parametrize(
    ("stops", "is_ball"),
    [
        ([(0.5, 0.3), (1.2, 0.4), (1.3, 0.8)], True),  # one turn: there may be a ball that is not detected
        ([(0.5, 0.3), (1.2, 0.4), (1.3, 0.8), (0.7, 0.9)], False),
        ([(0.5, 0.3), (1.2, 0.4), (1.2, 0.4), (1.3, 0.8), (1.3, 0.8)], False),  # stops, and goes on by itself
    ],
)
def test_an_object_that_turns_or_stops_twice_in_the_open_is_no_ball(
    stops: list[tuple[float, float]], is_ball: bool
) -> None:
    (tracklet,), detections, t = observe((0, drag(stops)))
    assert moves_like_ball(tracklet, [], detections, t, POOL) == is_ball


@pytest.mark.parametrize(
    ("frames", "score", "is_true"),
    [
        (range(60), 0.6, True),
        ([k for k in range(60) if k % 3], 0.9, True),  # hidden again and again by balls around it
        ([k for k in range(60) if k % 3], 0.6, False),
        ([k for k in range(60) if k % 3 == 0], 0.9, False),  # part of a net
        (range(20, 60), 0.9, True),  # a player hides it first
        (range(20, 60), 0.6, False),
        (range(40), 0.6, False),
    ],
)
def test_an_object_that_appears_vanishes_or_flickers_is_a_ball_only_where_it_looks_like_one(
    frames: list[int], score: float, is_true: bool
) -> None:
    (other, whole), detections, t = observe((0, np.full((60, 2), 0.9)), (0, np.full((60, 2), 0.5)))
    detections = replace(detections, score=np.full(len(detections.row), score))
    tracklet = make_tracklet(np.array(frames), whole.row[np.array(frames)], detections, t)
    assert is_ball(other, replace(detections, score=0 * detections.score), t, overhead())
    assert is_ball(tracklet, detections, t, overhead()) == is_true
