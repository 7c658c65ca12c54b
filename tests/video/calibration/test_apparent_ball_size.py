"""Apparent ball sizes agree with a right table and contradict a wrong one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.sample_clips import NAMES, read_sample_truth
from support.table_images import TableColours, draw_table, look_at_table

from models.core.scene import Scene
from models.physics.billiards.tables import CAROM_BALL, TABLE_PRESETS, estimate_preset_ball_size, parse_table
from video.calibration.ball_size import BallSizes, measure_ball_sizes
from video.calibration.table_classifier import classify_table
from video.calibration.table_finder import calibrate_clip, calibrate_image
from video.io.clip import open_clip
from video.io.video_options import CalibrateOptions

TABLE = TABLE_PRESETS["pool-9ft"]


def calibrate(factor: float, options: CalibrateOptions) -> Scene:
    """Calibrate an image of a 9 ft table from above, with balls `factor` times as large as those of pool."""
    rng = np.random.default_rng(3)
    table = replace(TABLE, ball_radius=factor * TABLE.ball_radius)
    centre = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
    camera = look_at_table(TABLE, 900.0, (1280, 720), centre + np.array([0.0, 0.5, 2.4]), centre, 0.02)
    places = np.stack(np.meshgrid(np.linspace(0.3, 2.2, 5), np.linspace(0.25, 1.0, 2)), axis=-1).reshape(-1, 2)
    image = draw_table(TABLE, camera, TableColours(), None, rng)
    with_balls = draw_table(table, replace(camera), TableColours(), places, rng)
    # Only the balls differ: the noses stay at the height of the true table.
    seen = np.zeros(image.shape[:2], bool)
    rows, columns = np.indices(seen.shape)
    for x, y in camera.to_pixels(places, table.ball_radius):
        seen |= np.hypot(columns - x, rows - y) < 1.4 * float(camera.radius_px(centre[:2], table.ball_radius))
    return calibrate_image(np.where(seen[..., None], with_balls, image).astype(np.uint8), options)


def test_balls_of_the_right_size_confirm_the_preset() -> None:
    scene = calibrate(1.0, CalibrateOptions(table="pool-9ft"))
    assert scene.table == TABLE
    assert scene.ball_size.source == "combined"
    assert scene.warnings == ()
    preset, image = scene.ball_size_estimates
    assert image.source == "image"
    assert abs(image.radius - TABLE.ball_radius) < 3 * image.sigma
    assert 0.005 < image.sigma / image.radius < 0.04
    assert preset.sigma == pytest.approx(0.0635e-3 / np.sqrt(3))


@pytest.mark.parametrize("factor", [0.88, 1.12])
def test_balls_that_contradict_the_table_are_measured_and_reported(factor: float) -> None:
    scene = calibrate(factor, CalibrateOptions(table="pool-9ft"))
    assert scene.ball_size.source == "image"
    assert scene.table.ball_radius == pytest.approx(factor * TABLE.ball_radius, rel=0.03)
    assert scene.table.ball_mass == pytest.approx(TABLE.ball_mass * (scene.table.ball_radius / TABLE.ball_radius) ** 3)
    (warning,) = scene.warnings
    assert warning.startswith("The balls look ")
    assert ("larger" if factor > 1 else "smaller") in warning
    assert warning in scene.notes


def test_the_size_of_the_user_is_used_and_compared() -> None:
    wrong = calibrate(1.0, CalibrateOptions(table="pool-9ft", ball_radius=0.0325))
    assert (wrong.table.ball_radius, wrong.ball_size.source) == (0.0325, "user")
    assert len(wrong.warnings) == 1
    assert "65 mm in diameter" in wrong.warnings[0]
    right = calibrate(1.12, CalibrateOptions(table="pool-9ft", ball_radius=0.032))
    assert (right.table.ball_radius, right.warnings) == (0.032, ())


def test_a_classified_table_has_the_spread_of_the_candidates() -> None:
    unsure = classify_table(BallSizes(0.0120, 0.0008, 20), pockets=True, has_d=False)
    sure = classify_table(BallSizes(0.01125, 0.0001, 20), pockets=True, has_d=False)
    assert unsure.estimate_ball_size().sigma > 0.03 * unsure.table.ball_radius
    assert sure.estimate_ball_size().sigma < 0.002 * sure.table.ball_radius
    assert sure.estimate_ball_size().radius == TABLE.ball_radius


def test_a_table_of_another_size_has_balls_of_the_nearest_preset() -> None:
    size = estimate_preset_ball_size(parse_table("2.8x1.4"))
    assert (size.radius, size.source) == (CAROM_BALL.radius, "preset")
    assert size.sigma == pytest.approx(CAROM_BALL.tolerance / np.sqrt(3))


def test_too_few_objects_are_no_estimate() -> None:
    assert BallSizes(0.01125, 0.0005, 2).estimate_ball_size(TABLE) is None
    assert BallSizes(0.0025, 0.0005, 9, 0.0001).estimate_ball_size(TABLE) is None  # 6 mm
    size = BallSizes(0.01125, 0.0005, 9, 0.0002).estimate_ball_size(TABLE)
    assert size is not None
    assert size.radius == pytest.approx(TABLE.ball_radius)


def test_marks_and_scraps_do_not_outvote_the_only_ball() -> None:
    home, rng = TABLE_PRESETS["home-4ft"], np.random.default_rng(4)
    middle = np.array([home.length / 2, home.width / 2, 0.0])
    camera = look_at_table(home, 900.0, (960, 540), middle + np.array([0.0, 0.0, 1.4]), middle, 0.0)
    empty = draw_table(home, camera, TableColours())
    spots = [(home.length / 4, home.width / 2, 0.3), (0.75 * home.length, home.width / 2, 0.3)]
    images = []
    for k in range(6):  # a ball that moves, beside two marks; finger tips and chalk come and go
        scraps = [(*rng.uniform(0.1, 0.5, 2), share) for share in rng.uniform(0.3, 0.55, 1 + k % 2)]
        image = empty.copy()
        for x, y, share in [(0.3 + 0.12 * k, 0.15, 1.0), *spots, *scraps]:
            place = np.rint(16 * camera.to_pixels(np.array([x, y]), home.ball_radius)).astype(int).tolist()
            radius = share * float(camera.radius_px(np.array([x, y]), home.ball_radius))
            cv2.circle(image, tuple(place), round(16 * radius), (240, 235, 220), -1, cv2.LINE_AA, 4)
        images.append(cv2.GaussianBlur(image, (0, 0), 0.6))
    sizes = measure_ball_sizes([np.asarray(image, np.uint8) for image in images], empty, camera, home)
    assert sizes.radius_ratio == pytest.approx(home.ball_radius / home.length, rel=0.06)
    assert sizes.estimate_ball_size(home) is not None


@pytest.mark.parametrize("name", NAMES)
def test_sample_clips_confirm_their_balls(name: str) -> None:
    truth = read_sample_truth(name)
    length, width = truth.scene["table"]["length"], truth.scene["table"]["width"]
    scene = calibrate_clip(open_clip(truth.path), CalibrateOptions(table=f"{length}x{width}"))
    nominal, image = scene.ball_size_estimates
    assert nominal.radius == scene.table.ball_radius == truth.scene["ball_radius"]
    assert image.radius == pytest.approx(truth.scene["ball_radius"], abs=2 * image.sigma)
    assert image.sigma < 0.04 * image.radius
    assert scene.warnings == ()
