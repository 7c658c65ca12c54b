"""Rendered images compared with their truth: positions, streaks, light, lens, readout, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.core.scene import Camera, Table
from video.rendering.pinhole_camera import look_at, project_points
from video.rendering.player_props import make_cue_rods
from video.rendering.scene_appearance import BallAppearance, Lamp, SceneAppearance, pool_ball
from video.rendering.scene_renderer import (
    BallPoses,
    Motion,
    SceneView,
    apply_sensor_model,
    build_view,
    project_ball_centres,
    render_exposure,
    render_image,
)

TABLE = Table("small", "carom", 1.0, 0.5, 0.0286, 0.17, False)
WHITE = BallAppearance("cue", (1.0, 1.0, 1.0))
PLAIN = SceneAppearance(
    cloth=(0.0, 0.0, 0.0),
    marks="none",
    ambient=0.9,
    gloss=0.0,
    wear=0.0,
    vignette=0.0,
    blur_px=0.0,
    noise=0.0,
    lamps=(Lamp((0.5, 0.25, 1.5)),),
)


def overhead() -> Camera:
    return look_at(TABLE, np.array([0.5, 0.25, 1.6]), np.array([0.5, 0.25, 0.0]), 400.0, 320, 200, up=(0.0, -1.0, 0.0))


def oblique() -> Camera:
    return look_at(TABLE, np.array([0.4, 1.4, 1.0]), np.array([0.5, 0.22, 0.0]), 420.0, 320, 200)


def straight(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Motion:
    """Return the motion of one ball without rotation."""

    def motion(t: float) -> BallPoses:
        return BallPoses(np.array([[x + vx * t, y + vy * t, TABLE.ball_radius]]), np.eye(3)[None])

    return motion


def centre_of_light(view: SceneView, motion: Motion, t: float = 0.0) -> tuple[np.ndarray, float]:
    """Return the centroid (px) of the light that a white ball adds, and its sum."""
    added = np.clip((render_exposure(view, motion, t) - view.empty.image).sum(axis=2), 0, None)
    rows, columns = np.mgrid[: added.shape[0], : added.shape[1]]
    return np.array([(columns * added).sum(), (rows * added).sum()]) / added.sum(), float(added.sum())


@pytest.fixture(scope="module", params=[overhead, oblique])
def view(request: pytest.FixtureRequest) -> SceneView:
    return build_view(TABLE, request.param(), PLAIN, (WHITE,))


def test_the_outline_of_a_ball_is_centred_where_its_centre_projects(view: SceneView) -> None:
    for x, y in ((0.5, 0.25), (0.31, 0.13), (0.77, 0.4)):
        motion = straight(x, y)
        added = np.abs(render_exposure(view, motion, 0.0) - view.empty.image).sum(axis=2) > 0.25
        rows, columns = np.nonzero(added)
        expected = project_ball_centres(view, motion, 0.0)[0]
        assert [columns.mean(), rows.mean()] == pytest.approx(expected, abs=0.25)
        radius = np.sqrt(added.sum() / np.pi)
        assert radius == pytest.approx(view.camera.radius_px(np.array([x, y]), TABLE.ball_radius), abs=0.35)


def test_the_camera_agrees_with_the_projection_of_the_scene(view: SceneView) -> None:
    xy = np.array([0.2, 0.3])
    expected = view.camera.to_pixels(xy, 0.03)
    assert project_points(view.camera, view.lens, np.append(xy, 0.03)) == pytest.approx(expected, abs=1e-9)
    x_axis = view.camera.to_pixels(np.array([[0.0, 0.2], [1.0, 0.2], [0.0, 0.4]]), 0.0)
    assert x_axis[1, 0] > x_axis[0, 0]
    assert x_axis[2, 1] > x_axis[0, 1]


def test_a_streak_is_as_long_as_speed_times_exposure_and_keeps_the_light() -> None:
    still = build_view(TABLE, overhead(), PLAIN, (WHITE,))
    blurred = replace(still, exposure=0.02)
    motion = straight(0.45, 0.25, vx=3.0)
    rest, light = centre_of_light(still, motion)
    middle, spread = centre_of_light(blurred, motion)
    assert middle == pytest.approx(rest, abs=0.05)
    assert spread == pytest.approx(light, rel=0.01)
    shown = (render_exposure(blurred, motion, 0.0) - still.empty.image).sum(axis=2) > 0.02
    columns = np.flatnonzero(shown.any(axis=0))
    per_metre = 400.0 / (1.6 - TABLE.ball_radius)
    assert np.ptp(columns) + 1 == pytest.approx((3.0 * 0.02 + 2 * TABLE.ball_radius) * per_metre, abs=2.5)


def test_rows_that_are_read_later_see_a_ball_further_on() -> None:
    prompt = build_view(TABLE, overhead(), PLAIN, (WHITE,))
    rolling = replace(prompt, readout=0.02)
    for y, sign in ((0.1, -1), (0.4, 1)):
        motion = straight(0.5, y, vx=2.0)
        before, _ = centre_of_light(prompt, motion)
        after, _ = centre_of_light(rolling, motion)
        expected = project_ball_centres(rolling, motion, 0.0)[0] - project_ball_centres(prompt, motion, 0.0)[0]
        assert expected[0] * sign > 1.5
        assert after - before == pytest.approx(expected, abs=0.1)


def test_the_lens_moves_the_corners_by_its_formula() -> None:
    camera = overhead()
    bent = build_view(TABLE, camera, PLAIN, (WHITE,), k1=0.05)
    pinhole = camera.to_pixels(TABLE.corners[:1], 0.0)[0]
    centre = np.array([159.5, 99.5])
    r = np.linalg.norm(pinhole - centre) / (400.0 / 1.6 / 2)
    expected = centre + (pinhole - centre) * (1 + 0.05 * r**2)
    assert project_points(camera, bent.lens, np.array([0.0, 0.0, 0.0])) == pytest.approx(expected, abs=1e-9)
    assert bent.lens.undistort(expected) == pytest.approx(pinhole, abs=1e-4)


def test_a_ball_casts_its_shadow_away_from_the_lamp() -> None:
    look = replace(PLAIN, cloth=(0.6, 0.6, 0.6), ambient=0.2, lamps=(Lamp((0.0, 0.25, 0.6), 0.03),))
    view = build_view(TABLE, overhead(), look, (WHITE,))
    dimmed = (render_exposure(view, straight(0.5, 0.25), 0.0) / view.empty.image).mean(axis=2)
    x, y = np.round(project_ball_centres(view, straight(0.5, 0.25), 0.0)[0]).astype(int)
    assert dimmed[y, x + 14] < 0.6
    assert dimmed[y, x - 14] > 0.85


def test_a_rotated_ball_shows_another_side_and_a_full_turn_the_same() -> None:
    view = build_view(TABLE, overhead(), PLAIN, (pool_ball(11),))
    place = np.array([[0.5, 0.25, TABLE.ball_radius]])

    def turned(angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        return render_exposure(view, lambda _: BallPoses(place, turn[None]), 0.0)

    assert np.abs(turned(0.0) - turned(np.pi / 2)).max() > 0.2
    assert turned(0.0) == pytest.approx(turned(2 * np.pi), abs=1e-4)


def test_noise_has_the_requested_strength_and_comes_from_the_generator() -> None:
    look = replace(PLAIN, cloth=(0.485, 0.485, 0.485), noise=2.0)
    view = build_view(TABLE, overhead(), look, (WHITE,))
    level = np.full((200, 320, 3), 0.2, np.float32)
    image = apply_sensor_model(view, level, np.random.default_rng(1)).astype(float)
    assert image.std() == pytest.approx(2.0, rel=0.1)
    motion = straight(0.5, 0.25, vx=1.0)
    first, second = (render_image(view, motion, 0.1, np.random.default_rng(seed)) for seed in (3, 3))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, render_image(view, motion, 0.1, np.random.default_rng(4)))


def test_a_ball_that_is_gone_leaves_the_empty_table() -> None:
    view = build_view(TABLE, overhead(), PLAIN, (WHITE,))
    gone = BallPoses(np.full((1, 3), np.nan), np.eye(3)[None])
    assert np.array_equal(render_exposure(view, lambda _: gone, 0.0), view.empty.image)


def test_the_near_cushion_hides_the_foot_of_a_ball_and_a_sunk_ball_is_gone() -> None:
    view = build_view(TABLE, oblique(), PLAIN, (WHITE,))
    open_cloth = straight(0.5, 0.25)
    frozen = straight(0.5, TABLE.width - TABLE.ball_radius)
    rendered = [
        np.abs(render_exposure(view, motion, 0.0) - view.empty.image).sum(axis=2) > 0.25
        for motion in (open_cloth, frozen)
    ]
    sizes = [float(view.camera.radius_px(motion(0.0).xyz[0, :2], TABLE.ball_radius)) for motion in (open_cloth, frozen)]
    covered = [mask.sum() / (np.pi * size**2) for mask, size in zip(rendered, sizes, strict=True)]
    assert covered[0] == pytest.approx(1.0, abs=0.1)
    assert covered[1] < 0.97 * covered[0]
    below = BallPoses(np.array([[0.5, 0.25, -2 * TABLE.ball_radius]]), np.eye(3)[None])
    changed = np.abs(render_exposure(view, lambda _: below, 0.0) - view.empty.image).max()
    assert changed < 0.05


def test_a_cue_covers_the_image_from_its_tip_backwards() -> None:
    view = build_view(TABLE, overhead(), replace(PLAIN, cloth=(0.2, 0.5, 0.3)), (WHITE,))
    tip = np.array([0.6, 0.25, 0.03])
    poses = BallPoses(np.full((1, 3), np.nan), np.eye(3)[None], make_cue_rods(tip, np.array([1.0, 0.0])))
    changed = np.abs(render_exposure(view, lambda _: poses, 0.0) - view.empty.image).sum(axis=2) > 0.1
    x, y = np.round(project_points(view.camera, view.lens, tip)).astype(int)
    assert changed[y, x - 20]
    assert not changed[:, x + 4 :].any()
    assert changed[:, : x - 20].sum() > 400
