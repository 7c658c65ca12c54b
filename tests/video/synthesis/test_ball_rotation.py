"""Painted balls, lit from a fixed side, that rotate by their spin or otherwise."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support import staged_shot as shot

from models.core.typing import FloatArray, ImageArray
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import BallOutline, MattedSprite, matte_balls
from video.matting.ball_timeline import BallTimeline, build_ball_timeline
from video.matting.compositing import RotationWarp
from video.synthesis.ball_rotation import BallRotation, estimate_rotation, states_between_frames
from video.synthesis.frame_synthesis import prepare_interval

TIMES = np.arange(12) / 12
"""s; the ball rolls 1.3 radii, and rotates by 75 degrees, from each time to the next."""
ROW = 5
RADIUS = shot.RADIUS * shot.SCALE
WHITE, RED, YELLOW = (np.array(rgb, dtype=float) for rgb in ([235, 232, 220], [190, 30, 40], [220, 190, 40]))


def rotation_of_rolling_ball(t: float) -> FloatArray:
    """Rotation (3, 3) of the rolling ball in axes right, down and up: its top moves to the right."""
    angle = (shot.place(t)[0, 0] - 0.3) / shot.RADIUS
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


def paint(on_ball: FloatArray) -> FloatArray:
    """Colours (..., 3) of a striped ball with a spot, by places (..., 3) on it."""
    stripe, spot = np.abs(on_ball[..., 1] - 0.2 * on_ball[..., 0]) < 0.3, on_ball @ [0.55, 0.6, 0.58] > 0.9
    return np.where(spot[..., None], YELLOW, np.where(stripe[..., None], RED, WHITE))


def film(t: float, turn: FloatArray | None = None, plain: bool = False, gloss: bool = True) -> ImageArray:
    """The frame at time t: the rotated painted ball with gloss in the direction of the lamp."""
    image = shot.cloth().astype(float)
    centre = shot.place(t)[0] * shot.SCALE + shot.MARGIN
    fine = 4
    y, x = (np.mgrid[0 : shot.HEIGHT * fine, 0 : shot.WIDTH * fine] + 0.5) / fine - 0.5
    u, v = (x - centre[0]) / RADIUS, (y - centre[1]) / RADIUS
    on = u**2 + v**2 < 1
    outward = np.stack([u[on], v[on], np.sqrt(1 - u[on] ** 2 - v[on] ** 2)], axis=-1)
    body = outward @ (rotation_of_rolling_ball(t) if turn is None else turn)
    colours = (np.broadcast_to(RED, body.shape) if plain else paint(body)) * (0.55 + 0.45 * outward[:, 2:])
    if gloss:
        colours = colours + 120 * (outward @ [-0.3, -0.3, 0.905] > 0.985)[:, None]
    large = np.repeat(np.repeat(image, fine, axis=0), fine, axis=1)
    large[on] = np.clip(colours, 0, 255)
    small = cv2.resize(large, (shot.WIDTH, shot.HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(small), dtype=np.uint8)


def rolling_timeline(spinning: bool = True, times: FloatArray = TIMES) -> BallTimeline:
    fit = shot.fit(times)
    spin = np.zeros_like(fit.trajectory.spin)
    rolls = 0.9 / shot.RADIUS if spinning else np.nan
    spin[fit.trajectory.ball == 0, 0] = [0.0, 0.0, np.nan]
    spin[1, 0, 1] = rolls
    moving = replace(fit, trajectory=replace(fit.trajectory, spin=spin))
    return build_ball_timeline(shot.scene(), shot.tracks(times), moving)


def plate() -> BackgroundPlate:
    return BackgroundPlate(shot.cloth(), np.ones((shot.HEIGHT, shot.WIDTH), dtype=bool))


def matte_ball(image: ImageArray, t: float) -> MattedSprite:
    centre = shot.place(t)[0] * shot.SCALE + shot.MARGIN
    sprite = matte_balls(image, [BallOutline(centre[None], centre, RADIUS)], [], plate(), None).sprites[0]
    assert sprite is not None
    return sprite


def estimate_between(first: ImageArray, second: ImageArray, times: FloatArray = TIMES) -> BallRotation | None:
    timeline = rolling_timeline(times=times)
    sides = (matte_ball(first, float(times[ROW])), matte_ball(second, float(times[ROW + 1])))
    return estimate_rotation(timeline, ROW, 0, states_between_frames(timeline, ROW), sides, RADIUS)


def synthesis_error(timeline: BallTimeline, share: float) -> float:
    """Root mean squared error, levels, on the ball of a frame synthesized at a share of the gap."""
    first, second = (film(float(t)) for t in TIMES[ROW : ROW + 2])
    t = float(TIMES[ROW] + share * (TIMES[ROW + 1] - TIMES[ROW]))
    interval = prepare_interval(timeline, plate(), ROW, first, second)
    synthesized = interval.synthesize(t, timeline.centres_at(t, timeline.state_at(np.array([t])).xy[0]))
    centre = shot.place(t)[0] * shot.SCALE + shot.MARGIN
    y, x = np.mgrid[0 : shot.HEIGHT, 0 : shot.WIDTH]
    on = np.hypot(x - centre[0], y - centre[1]) < RADIUS
    return float(np.sqrt(((synthesized.astype(float) - film(t)) ** 2)[on].mean()))


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_paint_rotates_with_the_spin_farther_than_flow_can_follow(share: float) -> None:
    assert synthesis_error(rolling_timeline(), share) < 0.6 * synthesis_error(rolling_timeline(spinning=False), share)


def test_the_top_of_a_ball_moves_in_the_rolling_direction() -> None:
    spin = estimate_between(film(float(TIMES[ROW])), film(float(TIMES[ROW + 1])))
    assert spin is not None
    step = 0.9 * (TIMES[1] - TIMES[0]) / shot.RADIUS
    assert spin.rotation_at(1.0) @ [0, 0, 1] == pytest.approx([np.sin(step), 0, np.cos(step)], abs=1e-6)
    assert spin.rotation_at(0.3) @ [0, 0, 1] == pytest.approx([np.sin(0.3 * step), 0, np.cos(0.3 * step)], abs=1e-6)
    assert spin.rotation_at(0.0) == pytest.approx(np.eye(3), abs=1e-9)


@pytest.mark.parametrize("angle", [-0.6, 0.4])
def test_a_rotation_about_the_vertical_axis_follows_from_the_markings(angle: float) -> None:
    times, parts = TIMES / 3 + 0.2, 200
    step = 0.9 * (times[1] - times[0]) / shot.RADIUS / parts
    rolled = np.linalg.matrix_power(cv2.Rodrigues(np.array([0.0, step, angle / parts]))[0], parts)
    first = rotation_of_rolling_ball(float(times[ROW]))
    spin = estimate_between(film(float(times[ROW]), first), film(float(times[ROW + 1]), rolled @ first), times)
    assert spin is not None
    off, _ = cv2.Rodrigues(spin.rotation_at(1.0) @ rolled.T)
    assert np.linalg.norm(off) < 0.2 < abs(angle)


def test_paint_that_contradicts_the_spin_is_not_rotated() -> None:
    first, other = (
        rotation_of_rolling_ball(0.2),
        rotation_of_rolling_ball(0.2) @ cv2.Rodrigues(np.array([1.2, 0.0, 0.5]))[0],
    )
    slid = film(float(TIMES[ROW]), turn=first), film(float(TIMES[ROW + 1]), turn=other)
    assert estimate_between(*slid) is None


def test_gloss_stays_where_it_is_on_a_plain_ball() -> None:
    first, second = (film(float(t), plain=True) for t in TIMES[ROW : ROW + 2])
    assert estimate_between(first, second) is None


def test_gloss_is_separated_from_paint_where_both_meet() -> None:
    spin = estimate_between(film(float(TIMES[ROW])), film(float(TIMES[ROW + 1])))
    assert spin is not None
    middle = spin.light.shape[0] // 2
    lamp = tuple(np.rint(middle + RADIUS * np.array([-0.3, -0.3])).astype(int)[::-1])
    dull = film(float(TIMES[ROW]), gloss=False), film(float(TIMES[ROW + 1]), gloss=False)
    without_gloss = estimate_between(*dull)
    assert without_gloss is not None
    assert float(spin.light[lamp].max()) > float(without_gloss.light[lamp].max()) + 10


def test_a_ball_with_unknown_spin_is_not_rotated() -> None:
    timeline = rolling_timeline(spinning=False)
    sides = tuple(matte_ball(film(float(t)), float(t)) for t in TIMES[ROW : ROW + 2])
    assert (
        estimate_rotation(timeline, ROW, 0, states_between_frames(timeline, ROW), (sides[0], sides[1]), RADIUS) is None
    )


def test_no_light_leaves_a_hole_in_a_ball() -> None:
    """Gloss estimated too broad makes a place at most as dark as the darkest paint, or as it was."""
    colour = np.array([[[200.0, 200.0, 200.0], [90.0, 90.0, 90.0], [20.0, 20.0, 20.0]]], dtype=np.float32)
    light = np.full((1, 3, 3), -150.0, dtype=np.float32)
    bend = np.zeros((1, 3, 2), dtype=np.float32)
    lit = RotationWarp(bend, darkest_level=np.full(3, 40.0, dtype=np.float32)).add_light(colour, light)
    assert lit[0, :, 0].tolist() == [50.0, 40.0, 20.0]
    half = RotationWarp(bend, darkest_level=np.full(3, 40.0, dtype=np.float32)).add_light(0.5 * colour, light, 0.5)
    assert half[0, :, 0].tolist() == [25.0, 20.0, 10.0]
    assert RotationWarp(bend).add_light(colour, light)[0, 2, 0] == -130.0
