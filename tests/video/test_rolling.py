from __future__ import annotations

import numpy as np
import pytest
import staged_shot as shot
from numpy.typing import NDArray

from models.scene import Camera
from models.trajectory import Trajectory
from video.ball_paint import Paint, paints_of
from video.pasting import Layer, paste
from video.plate import Plate
from video.rolling import STEPS, Roll, matrix_of, roll_between, turns_of, vector_of, view_at
from video.sprites import Outline, Sprite, peel

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

SIZE, RADIUS, CENTRE = 64, 13.0, np.array([31.3, 32.6])
DOTS = np.array([[0.1, 0.45, 0.89], [0.55, -0.45, 0.7], [-0.6, 0.1, 0.79]])
DOT_COSINE = 0.96
VIEWS = np.stack([np.eye(3)] * 2)
TURN = np.array([0.1, 0.7, 0.0])
"""rad between the sightings: the ball rolls to the right."""


def filmed(turn: Floats, dots: Floats = DOTS, red: float = 210.0) -> Picture:
    """A ball with white dots that has turned, on a green cloth, lit from above left, with a reflection that stays."""
    fine = 3
    v, u = np.mgrid[0 : SIZE * fine, 0 : SIZE * fine] / fine + (1 / fine - 1) / 2
    x, y = (u - CENTRE[0]) / RADIUS, (v - CENTRE[1]) / RADIUS
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)
    body = normal @ matrix_of(turn)
    dotted = (body @ (dots / np.linalg.norm(dots, axis=1, keepdims=True)).T > DOT_COSINE).any(axis=-1)
    colour = np.where(dotted[..., None], (235.0, 235.0, 225.0), (red, 40.0, 35.0))
    colour = colour * np.clip(0.75 + 0.25 * normal[..., 2:] - 0.1 * normal[..., :1] - 0.1 * normal[..., 1:2], 0, 1)
    colour = np.where((np.hypot(x + 0.3, y + 0.35) < 0.12)[..., None], 250.0, colour)
    picture = np.where((np.hypot(x, y) < 1)[..., None], colour, (40.0, 120.0, 60.0))
    return np.rint(picture.reshape(SIZE, fine, SIZE, fine, 3).mean(axis=(1, 3))).astype(np.uint8)


def cut_out(picture: Picture) -> Sprite:
    cloth = np.full((SIZE, SIZE, 3), (40, 120, 60), dtype=np.uint8)
    plate = Plate(cloth, np.ones((SIZE, SIZE), dtype=bool))
    sprite = peel(picture, [Outline(CENTRE[None], CENTRE, RADIUS)], [], plate, None).sprites[0]
    assert sprite is not None
    return sprite


def sightings(turn: Floats, dots: Floats = DOTS) -> tuple[Sprite, Sprite]:
    return cut_out(filmed(np.zeros(3), dots)), cut_out(filmed(turn, dots))


def evenly(turn: Floats) -> Floats:
    return np.stack([matrix_of(turn * share) for share in np.linspace(0, 1, STEPS + 1)])


def roll(pair: tuple[Sprite, Sprite], said: Floats) -> Roll | None:
    return roll_between(paints_of(*pair, RADIUS), np.linspace(0, 1, STEPS + 1), evenly(said), VIEWS)


def made(pair: tuple[Sprite, Sprite], found: Roll | None, share: float) -> Picture:
    picture = np.full((SIZE, SIZE, 3), (40, 120, 60), dtype=np.uint8)
    turns = (None, None) if found is None else found.at(share)
    layers = [Layer(s, CENTRE[None], w, None, t) for s, w, t in zip(pair, (1 - share, share), turns, strict=True)]
    paste(picture, [layers])
    return picture


def error(picture: Picture, truth: Picture) -> float:
    return float(((picture.astype(float) - truth) ** 2).mean())


@pytest.mark.parametrize("share", [0.25, 0.5, 0.8])
def test_what_is_painted_on_a_ball_rolls_with_it(share: float) -> None:
    pair, truth = sightings(TURN), filmed(TURN * share)
    found = roll(pair, TURN)
    assert found is not None
    assert error(made(pair, found, share), truth) < 0.7 * error(made(pair, None, share), truth)


def test_a_turn_that_the_eye_can_follow_is_left_to_optical_flow() -> None:
    assert roll(sightings(0.3 * TURN), 0.3 * TURN) is None


def test_shade_that_stays_is_no_paint_however_fast_a_ball_turns() -> None:
    pair = sightings(np.zeros(3))
    assert roll(pair, TURN) is None
    assert roll(pair, 3 * TURN) is None


def test_a_turn_that_the_sightings_contradict_is_not_believed() -> None:
    assert roll(sightings(TURN), np.array([0.0, 0.05, 0.7])) is None


def test_a_plain_ball_has_no_marks_and_its_reflection_is_none() -> None:
    nowhere = np.array([[0.0, 0.0, -1.0]])
    for paint in paints_of(*sightings(TURN, nowhere), RADIUS):
        assert np.abs(paint.marks[paint.disc[0]]).max() < 5


def test_dots_are_the_marks_of_a_ball_and_nothing_else_is() -> None:
    paint: Paint = paints_of(*sightings(TURN), RADIUS)[0]
    disc, normal = paint.disc
    cosine = (normal @ (DOTS / np.linalg.norm(DOTS, axis=1, keepdims=True)).T).max(axis=-1)
    assert np.median(paint.marks[disc & (cosine > 0.98), 1]) > 120
    assert np.median(np.abs(paint.marks[disc & (cosine < 0.88)])) < 5


def test_a_rolling_ball_turns_by_its_way_over_its_radius() -> None:
    radius, speed = 0.03, 0.6
    known = np.array([[[0.0, speed / radius, 0.0], [0.0] * 3]])
    for spin in (known, np.full((1, 2, 3), np.nan)):
        position = np.array([[[0.1, 0.2], [speed, 0.0], [0.0, 0.0], [0.0, 0.0]]])
        motion = Trajectory(
            ("a",), np.zeros(1, dtype=np.int64), np.zeros(1), np.ones(1), position, spin, ("roll",), np.zeros((1, 4, 4))
        )
        t, turned = turns_of(motion, radius, 0, 0.2, 0.25)
        assert t[[0, -1]].tolist() == [0.2, 0.25]
        assert vector_of(turned[-1]) == pytest.approx([0.0, speed * 0.05 / radius, 0.0])


def test_from_above_the_view_of_a_ball_has_the_axes_of_the_table() -> None:
    camera: Camera = shot.scene().camera
    eye = np.array([0.9, 0.5, 3.0])
    forward = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]])
    inner = np.array([[800.0, 0, 320], [0, 800.0, 240], [0, 0, 1]])
    above = Camera(
        inner @ np.column_stack([forward, -forward @ eye]), 640, 480, camera.corners_px, camera.corner_covariance,
        "cloth", 3.0, 0.0,
    )  # fmt: skip
    assert view_at(above, np.array([0.9, 0.5, 0.03])) == pytest.approx(np.eye(3), abs=1e-9)
    aside = view_at(above, np.array([1.5, 0.5, 0.03]))
    assert aside @ aside.T == pytest.approx(np.eye(3), abs=1e-9)
    assert aside[2] @ (eye - [1.5, 0.5, 0.03]) == pytest.approx(np.linalg.norm(eye - [1.5, 0.5, 0.03]))
