"""Calibration that starts from the view of earlier clips."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from models.core.scene import NOSE_HEIGHT_RADII, BallSize
from models.core.typing import FloatArray
from models.numerics.statistics import intersect_estimates, measure_contradiction
from models.physics.billiards.tables import TABLE_PRESETS
from video.calibration.table_finder import calibrate_clip
from video.calibration.view_prior import PROFILE_NOTE, ViewPrior
from video.io.clip import Clip, open_clip
from video.io.video_options import CalibrateOptions
from video.io.video_writer import VideoWriter
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import SceneAppearance, pool_ball
from video.rendering.scene_renderer import BallPoses, build_view, render_image

TABLE = TABLE_PRESETS["pool-8ft"]
MIDDLE = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
CAMERA = look_at(TABLE, MIDDLE + np.array([0.1, 2.2, 3.8]), MIDDLE, 1750.0, 1280, 720)
CORNERS = CAMERA.to_pixels(TABLE.corners, NOSE_HEIGHT_RADII * TABLE.ball_radius)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    path = tmp_path_factory.mktemp("clip") / "still.mp4"
    xy = np.array([[0.6, 0.5], [1.4, 0.4], [1.7, 0.8], [1.0, 0.9]])
    poses = BallPoses(np.column_stack([xy, np.full(4, TABLE.ball_radius)]), np.tile(np.eye(3), (4, 1, 1)))
    balls = tuple(pool_ball(number) for number in (0, 8, 3, 12))
    view = build_view(TABLE, CAMERA, SceneAppearance(), balls, samples=2)
    image = render_image(view, lambda t: poses, 0.0, np.random.default_rng(1))
    with VideoWriter(path, 1280, 720, Fraction(30)) as writer:
        for _ in range(6):
            writer.write(image)
    return open_clip(path)


def make_prior(corners: FloatArray, sigma: float = 0.7, lab: FloatArray | None = None) -> ViewPrior:
    size = BallSize(TABLE.ball_radius, 3e-4, "preset")
    return ViewPrior(TABLE, size, corners, sigma**2 * np.eye(8), (1280, 720), lab, 3)


def test_a_fitting_view_gives_the_corners_at_least_as_exactly_as_without(clip: Clip) -> None:
    alone = calibrate_clip(clip, CalibrateOptions(table="pool-8ft"))
    helped = calibrate_clip(clip, CalibrateOptions(), prior=make_prior(CORNERS + 0.05, lab=alone.cloth_lab))
    assert helped.table.name == "pool-8ft"
    assert not [note for note in helped.notes if note.startswith(PROFILE_NOTE)]
    assert any("3 earlier shots" in note for note in helped.notes)
    errors = [np.linalg.norm(scene.camera.corners_px - CORNERS, axis=1).max() for scene in (helped, alone)]
    assert errors[0] < min(errors[1] + 0.05, 1.0)
    assert np.trace(helped.camera.corner_covariance) <= np.trace(alone.camera.corner_covariance)


def test_a_camera_that_moved_is_named_and_its_old_view_is_not_used(clip: Clip) -> None:
    alone = calibrate_clip(clip, CalibrateOptions(table="pool-8ft"))
    moved = calibrate_clip(clip, CalibrateOptions(), prior=make_prior(CORNERS + np.array([9.0, 0.0])))
    np.testing.assert_array_equal(moved.camera.corners_px, alone.camera.corners_px)
    notes = [note for note in moved.notes if note.startswith(PROFILE_NOTE)]
    assert len(notes) == 1
    assert "the camera has moved" in notes[0]


def test_images_of_another_size_have_another_view(clip: Clip) -> None:
    scene = calibrate_clip(clip, CalibrateOptions(), prior=replace(make_prior(CORNERS), image_size=(1920, 1080)))
    assert any("another size" in note for note in scene.notes)


def test_another_cloth_is_named(clip: Clip) -> None:
    red = make_prior(CORNERS, lab=np.array([40.0, 55.0, 30.0]))
    notes = calibrate_clip(clip, CalibrateOptions(), prior=red).notes
    assert any(note.startswith(PROFILE_NOTE) and "another colour" in note for note in notes)


def test_equal_estimates_keep_their_covariance_and_a_better_one_wins() -> None:
    one = np.diag([1.0, 4.0])
    mean, covariance = intersect_estimates((np.zeros(2), one), (np.ones(2), one))
    np.testing.assert_allclose(mean, 0.5)
    np.testing.assert_allclose(covariance, one)
    mean, covariance = intersect_estimates((np.zeros(2), one), (np.ones(2), 1e-4 * one))
    np.testing.assert_allclose(mean, 1.0, atol=1e-6)
    np.testing.assert_allclose(covariance, 1e-4 * one)


def test_the_contradiction_of_independent_estimates_is_their_chi_square_probability() -> None:
    rng = np.random.default_rng(2)
    factor = rng.normal(size=(3, 3))
    covariance = factor @ factor.T
    pairs = rng.multivariate_normal(np.zeros(3), covariance, (2000, 2))
    levels = [measure_contradiction((a, covariance), (b, covariance)) for a, b in pairs]
    assert np.mean(np.array(levels) < 0.1) == pytest.approx(0.1, abs=0.025)
