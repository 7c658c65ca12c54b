"""The table is located in synthetic images with known corners, and in real clips."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.sample_clips import NAMES, read_sample_truth
from support.table_images import (
    TableColours,
    corner_error,
    draw_table,
    look_at_table,
    small_motion,
    warp_image,
    write_clip,
)

from models.core.errors import OptionError, TableNotFound
from models.core.scene import Camera, Scene, Table, apply_homography
from models.core.typing import FloatArray, ImageArray
from models.physics.billiards.tables import TABLE_PRESETS
from video.calibration.camera_model import orient_corners
from video.calibration.cloth_region import find_cloth_regions
from video.calibration.table_finder import calibrate_clip, calibrate_image, locate_table, parse_corners
from video.io.clip import open_clip
from video.io.video_options import CalibrateOptions

SIZE = (960, 540)
TABLE = TABLE_PRESETS["pool-9ft"]
CENTRE = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
LOOKS = {
    "green": TableColours(),
    "blue": TableColours(cloth=(45, 140, 190), wood=(50, 50, 48), floor=(30, 45, 60)),
    "red": TableColours(cloth=(165, 40, 70), wood=(30, 30, 32), floor=(215, 205, 190)),
    "grey": TableColours(cloth=(185, 186, 178), wood=(85, 86, 82), floor=(40, 40, 44)),
    "dark": TableColours(cloth=(20, 70, 55), wood=(70, 35, 25), floor=(15, 15, 18), noise=2.0),
}


def _make_camera(name: str) -> Camera:
    place, target, focal, roll = {
        "overhead": ((0.0, 0.0, 2.6), (0.0, 0.0), 900.0, 0.02),
        "tilted": ((0.1, 0.5, 2.4), (0.0, 0.0), 850.0, -0.05),
        "side": ((0.2, 2.6, 1.8), (0.0, 0.05), 1000.0, 0.0),
        "end": ((3.9, 0.1, 2.0), (-0.1, 0.0), 1500.0, np.pi / 2),
        "corner": ((-2.3, 2.6, 2.0), (0.0, 0.0), 1150.0, -0.72),
    }[name]
    return look_at_table(TABLE, 0.75 * focal, SIZE, CENTRE + np.array(place), CENTRE + np.array([*target, 0.0]), roll)


def _random_balls(rng: np.random.Generator, count: int = 9) -> FloatArray:
    grid = np.stack(np.meshgrid(np.linspace(0.3, 2.2, 6), np.linspace(0.2, 1.05, 4)), axis=-1).reshape(-1, 2)
    return rng.permutation(grid)[:count] + rng.uniform(-0.05, 0.05, (count, 2))


@pytest.mark.parametrize("name", ["overhead", "side"])
def test_a_turned_image_gives_the_turned_table(name: str) -> None:
    camera, rng = _make_camera(name), np.random.default_rng(7)
    image = draw_table(TABLE, camera, LOOKS["green"], _random_balls(rng), rng)
    level, upright = (calibrate_image(np.ascontiguousarray(np.rot90(image, k)), CalibrateOptions()) for k in (0, 1))
    x, y = level.camera.corners_px.T
    turned = np.column_stack([y, SIZE[0] - 1 - x])
    gap = np.linalg.norm(upright.camera.corners_px[:, None] - turned, axis=-1).min(axis=1)
    assert gap.max() < 0.5
    assert upright.table == level.table
    assert upright.camera.height == pytest.approx(level.camera.height, rel=0.02), "a view is as wide held upright"


def _calibrate_images(path: Path, images: list[ImageArray]) -> Scene:
    return calibrate_clip(open_clip(write_clip(path, images)), CalibrateOptions())


@pytest.mark.parametrize(
    ("view", "focal"), [("overhead", None), ("tilted", None), ("side", 1000), ("end", 1500), ("corner", 1150)]
)
def test_noses_are_found_from_above_and_from_the_sides(view: str, focal: float | None) -> None:
    rng = np.random.default_rng(3)
    camera = _make_camera(view)
    image = draw_table(TABLE, camera, LOOKS["green"], _random_balls(rng), rng)
    location = locate_table(image)
    assert corner_error(location.corners, camera.corners_px) < (0.7 if focal is None else 1.5)
    assert location.perspective.aspect == pytest.approx(2.0, rel=0.01)
    if focal is not None:
        assert location.perspective.focal == pytest.approx(0.75 * focal, rel=0.03)


@pytest.mark.parametrize("look", LOOKS)
def test_noses_are_found_on_cloths_of_many_colours(look: str) -> None:
    rng = np.random.default_rng(4)
    camera = _make_camera("tilted")
    image = draw_table(TABLE, camera, LOOKS[look], _random_balls(rng), rng)
    assert corner_error(locate_table(image).corners, camera.corners_px) < 1.0


def test_a_clip_gives_table_camera_and_ball_places(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    camera, balls = _make_camera("side"), _random_balls(rng)
    images = [draw_table(TABLE, camera, LOOKS["blue"], balls + np.array([0.01 * k, 0.0]), rng) for k in range(8)]
    scene = _calibrate_images(tmp_path / "side.mp4", images)
    assert scene.table.name == "pool-9ft"
    assert scene.camera.motion is None
    assert scene.camera.height == pytest.approx(1.8, rel=0.05)
    observed = camera.to_pixels(balls, TABLE.ball_radius)
    places = scene.camera.to_table(observed, TABLE.ball_radius)
    assert np.abs(places - balls).max() < 0.008
    radii = scene.camera.radius_px(balls, TABLE.ball_radius)
    np.testing.assert_allclose(radii, camera.radius_px(balls, TABLE.ball_radius), rtol=0.03)


def test_the_motion_of_a_hand_held_camera_is_estimated(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    camera = _make_camera("tilted")
    still = draw_table(TABLE, camera, LOOKS["red"], _random_balls(rng), None)
    motions = [small_motion(0.002 * k, (1.5 * k, -0.8 * k), 2e-7 * k) for k in range(10)]
    noisy = [np.clip(warp_image(still, m) + rng.normal(0, 2, still.shape), 0, 255).astype(np.uint8) for m in motions]
    scene = _calibrate_images(tmp_path / "hand.mp4", noisy)
    assert scene.camera.motion is not None
    assert scene.camera.motion.shape == (10, 3, 3)
    for frame in (0, 5, 9):
        observed = scene.camera.to_pixels(TABLE.corners, 0.0, frame)
        true = apply_homography(motions[frame], camera.to_pixels(TABLE.corners, 0.0))
        assert corner_error(observed, true) < 1.5


def test_a_table_is_found_where_the_image_ends_at_its_cloth() -> None:
    rng = np.random.default_rng(11)
    camera = _make_camera("overhead")
    image = draw_table(TABLE, camera, LOOKS["green"], _random_balls(rng), rng)
    low, high = camera.corners_px.min(axis=0), camera.corners_px.max(axis=0)
    margin = 0.045 * (high[0] - low[0]) / TABLE.length
    left, top = np.rint(low - margin).astype(int)
    right, bottom = np.rint(high + margin).astype(int)
    location = locate_table(np.ascontiguousarray(image[top:bottom, left:right]))
    assert corner_error(location.corners, camera.corners_px - [left, top]) < 1.0


@pytest.mark.parametrize("bow", [0.0, 2.0, 4.0])
def test_a_cloth_of_four_sides_is_a_region(bow: float) -> None:
    """The polygon of its four corners is smaller than the cloth, also where a lens bows the sides, px."""
    corners = np.array([[41.0, 222.0], [92.0, 110.0], [397.0, 116.0], [439.0, 235.0]])
    outline = []
    for one, two in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        share = np.linspace(0, 1, 50)[:, None]
        outwards = np.array([two[1] - one[1], one[0] - two[0]]) / np.linalg.norm(two - one)
        outline.append(one + share * (two - one) + 4 * share * (1 - share) * bow * outwards)
    image = np.full((360, 480, 3), (90, 75, 60), np.uint8)
    cv2.fillPoly(image, [np.rint(np.concatenate(outline)).astype(np.int32)], (24, 124, 36))
    best = find_cloth_regions(image)[0]
    assert np.linalg.norm(best.corners[:, None] - corners, axis=2).min(axis=1).max() < 2.0 + 1.5 * bow


def test_a_cloth_that_fills_the_image_is_no_table() -> None:
    rng = np.random.default_rng(12)
    cloth = np.full((360, 640, 3), (30, 140, 90)) + rng.normal(0, 3, (360, 640, 3))
    with pytest.raises(TableNotFound, match="filled by one surface"):
        locate_table(np.clip(cloth, 0, 255).astype(np.uint8))


def test_a_court_is_refused_by_its_painted_lines() -> None:
    rng = np.random.default_rng(13)
    camera = _make_camera("overhead")
    bare = replace(TABLE, pockets=False)
    image = draw_table(bare, camera, LOOKS["blue"], None, rng)
    for at in (0.125, 0.5, 0.875):
        along = camera.to_pixels(np.array([[0.0, at * TABLE.width], [TABLE.length, at * TABLE.width]]), 0.0)
        across = camera.to_pixels(np.array([[at * TABLE.length, 0.0], [at * TABLE.length, TABLE.width]]), 0.0)
        for start, end in (along, across):
            cv2.line(image, *(tuple(np.rint(px).astype(int).tolist()) for px in (start, end)), (240, 240, 240), 2)
    with pytest.raises(TableNotFound, match="a court without cushions, with 6 painted lines"):
        locate_table(image)


@pytest.mark.parametrize("width", [1280, 2560, 6000])
def test_a_home_table_is_found_at_every_image_size(width: int) -> None:
    home = replace(TABLE_PRESETS["home-4ft"], width=0.555)
    size = (width, width * 9 // 16)
    middle = np.array([home.length / 2, home.width / 2, 0.0])
    camera = look_at_table(home, 1.1 * width, size, middle + np.array([0.01, 0.02, 1.75]), middle, 0.01)
    balls = np.random.default_rng(14).uniform(0.1, 0.4, (8, 2)) * [2.6, 1.0]
    image = draw_table(home, camera, LOOKS["green"], balls)
    scene = calibrate_image(image, CalibrateOptions())
    assert corner_error(scene.camera.corners_px, camera.corners_px) < 0.004 * width
    assert scene.table.length / scene.table.width == pytest.approx(2.2, rel=0.02)
    assert scene.table.ball_radius / scene.table.length == pytest.approx(home.ball_radius / home.length, rel=0.06)
    assert any("times as long as wide" in warning for warning in scene.warnings)


def test_a_cut_to_another_view_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    first = draw_table(TABLE, _make_camera("overhead"), LOOKS["green"], _random_balls(rng), rng)
    second = draw_table(TABLE, _make_camera("corner"), LOOKS["green"], _random_balls(rng), rng)
    with pytest.raises(TableNotFound, match="one view"):
        _calibrate_images(tmp_path / "cut.mp4", [first] * 6 + [second] * 5)


@pytest.mark.parametrize("kind", ["noise", "stripes", "square"])
def test_an_image_without_a_table_is_refused_with_a_remedy(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    image = np.full((360, 640, 3), 60, np.uint8)
    if kind == "stripes":
        image[::40] = 200
    if kind == "square":
        image[80:280, 220:420] = (30, 140, 90)
    images = [np.clip(image + rng.normal(0, 25, image.shape), 0, 255).astype(np.uint8) for _ in range(6)]
    with pytest.raises(TableNotFound, match="--corners"):
        _calibrate_images(tmp_path / f"{kind}.mp4", images)


def test_corners_and_sizes_from_the_user_are_used(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    camera = _make_camera("end")
    image = draw_table(TABLE, camera, LOOKS["green"], _random_balls(rng), rng)
    clip = open_clip(write_clip(tmp_path / "given.mp4", [image] * 6))
    # Any order: here the first and third corners are swapped.
    text = ",".join(f"{x:.2f},{y:.2f}" for x, y in camera.corners_px[[2, 1, 0, 3]])
    scene = calibrate_clip(clip, CalibrateOptions(corners=text, table="2.24x1.12", ball_radius=0.026))
    assert corner_error(scene.camera.corners_px, camera.corners_px) < 0.01
    assert (scene.table.length, scene.table.width, scene.table.ball_radius) == (2.24, 1.12, 0.026)


def _calibrate_with_corners(path: Path, table: Table, shift: FloatArray) -> Scene:
    """Calibrate a drawn clip of a table with its corners moved by `shift` (4, 2) px."""
    rng = np.random.default_rng(9)
    camera = look_at_table(table, 600.0, SIZE, CENTRE + np.array([0.0, 0.3, 2.6]), CENTRE, 0.02)
    image = draw_table(table, camera, LOOKS["blue"], 1.1 * _random_balls(rng), rng)
    clip = open_clip(write_clip(path, [image] * 6))
    text = ",".join(f"{value:.1f}" for value in (camera.corners_px + shift).ravel())
    return calibrate_clip(clip, CalibrateOptions(corners=text))


@pytest.mark.parametrize(("name", "game"), [("carom-match", "carom"), ("pool-9ft", "pool")])
def test_corners_from_the_user_leave_table_and_game_to_the_image(name: str, game: str, tmp_path: Path) -> None:
    scene = _calibrate_with_corners(tmp_path / "given.mp4", TABLE_PRESETS[name], np.zeros((4, 2)))
    assert (scene.table.name, scene.table.game) == (name, game)
    assert scene.notes[0] == "corners were given by the user"
    assert not any("corner" in warning for warning in scene.warnings)


def test_a_given_corner_that_the_visible_noses_contradict_is_named(tmp_path: Path) -> None:
    shift = np.array([[0.0, 0.0], [-30.0, 26.0], [0.0, 0.0], [0.0, 0.0]])
    scene = _calibrate_with_corners(tmp_path / "given.mp4", TABLE_PRESETS["carom-match"], shift)
    x, y = scene.camera.corners_px[1]
    assert scene.table.game == "carom"
    assert scene.warnings[-1] == (
        f"The given corner at {x:.0f}, {y:.0f} px is 40 px from where the visible cushion noses meet: check the corners"
        " of the table."
    )


@pytest.mark.parametrize(
    "text", ["1,2,3", "a,b,c,d,e,f,g,h", "0,0,10,0,20,0,30,0", "9e9,0,1,0,1,1,0,1", "0,0,0,0,0,0,0,0"]
)
def test_corners_that_make_no_quadrangle_are_refused(text: str) -> None:
    with pytest.raises(OptionError, match="--corners"):
        parse_corners(text, 1280, 720)


def test_x_runs_along_the_longer_side_to_the_right_or_down() -> None:
    wide = np.array([[100.0, 100], [900, 110], [890, 500], [110, 490]])
    for turn in range(4):
        corners, _ = orient_corners(np.roll(wide, turn, axis=0), 1000, 600, 1.0)
        np.testing.assert_array_equal(corners, wide)
    tall = np.array([[400.0, 50], [700, 50], [700, 650], [400, 650]])
    corners, _ = orient_corners(tall, 1100, 700, 1.0)
    # x down the image; y turns clockwise from it, so it runs to the left and starts at the right.
    np.testing.assert_array_equal(corners, np.array([[700.0, 50], [700, 650], [400, 650], [400, 50]]))


def test_covariance_of_the_corners_covers_their_errors() -> None:
    rng = np.random.default_rng(10)
    scores: list[float] = []
    for view in ("overhead", "side"):
        camera = _make_camera(view)
        image = draw_table(TABLE, camera, replace(LOOKS["green"], noise=6.0), _random_balls(rng), rng)
        location = locate_table(image)
        scores.extend((location.corners - camera.corners_px).ravel() / np.sqrt(np.diag(location.covariance)))
    assert np.sqrt(np.mean(np.square(scores))) < 2.0


def _snooker_error(scene: Scene, footage: Path) -> float:
    """Root mean square error (m) over the cloth against the clips' own homography, which maps ball centres."""
    to_mm = np.array(json.loads((footage / "snooker_billiard-ai_pixel_to_mm.json").read_text())["pixel_to_mm_H"])
    grid = np.stack(np.meshgrid(np.linspace(0.05, 1.83, 9), np.linspace(0.05, 0.89, 5)), axis=-1)
    centred = np.stack([grid[..., 0] * 1000 - 940.5, 471.5 - grid[..., 1] * 1000], axis=-1)
    px = apply_homography(np.linalg.inv(to_mm), centred)
    miss = scene.camera.to_table(px, scene.table.ball_radius) - grid
    return float(np.sqrt(np.mean(np.sum(miss**2, axis=-1))))


def test_a_snooker_clip_is_calibrated_within_three_millimetres(footage: Path) -> None:
    scene = calibrate_clip(open_clip(footage / "snooker_simulation_vs_reality_1_0028_0032.mp4"), CalibrateOptions())
    assert scene.table.name == "snooker-6ft"
    assert _snooker_error(scene, footage) < 0.003


def test_a_carom_clip_has_the_limits_that_its_balls_reach(footage: Path) -> None:
    scene = calibrate_clip(open_clip(footage / "carom_F1.mp4"), CalibrateOptions())
    table, radius = scene.table, scene.table.ball_radius
    assert table.name == "carom-match"
    limits = json.loads((footage / "carom_F1.gt.json").read_text())["playing_area_centre_limits_px"]
    middles = np.array([[radius, 0.71], [table.length - radius, 0.71], [1.42, radius], [1.42, table.width - radius]])
    px = scene.camera.to_pixels(middles, radius)
    np.testing.assert_allclose([px[0, 0], px[1, 0]], limits["x"], atol=3)
    np.testing.assert_allclose([px[2, 1], px[3, 1]], limits["y"], atol=3)


EXPECTED = {
    "carom": ("carom-match", "right"),
    "pool9ft": ("pool-9ft", "right"),
    "pool8_game1_clip2": ("pool-9ft", "down"),
    "pool8_game2_clip1": ("pool-9ft", "down"),
    "pool8": ("pool-9ft", "right"),
    "snooker": ("snooker-6ft", "right"),
    "phone": ("blackball-6ft", "right"),
}


@pytest.mark.slow
def test_every_real_clip_has_the_right_table_and_orientation(footage: Path) -> None:
    for path in sorted(footage.glob("*.mp4")):
        name, direction = next(value for key, value in EXPECTED.items() if path.name.startswith(key))
        scene = calibrate_clip(open_clip(path), CalibrateOptions())
        along = scene.camera.corners_px[1] - scene.camera.corners_px[0]
        assert scene.table.name == name, path.name
        assert (along[0] > abs(along[1])) if direction == "right" else (along[1] > abs(along[0])), path.name
        assert (scene.camera.motion is not None) == path.name.startswith("phone"), path.name


def _calibration_error(name: str) -> tuple[Scene, float]:
    """Calibrate a sample clip; also return the RMS distance (m) of projected ball centres from their true places.

    Lengths are compared as shares of the table: one phone clip cannot distinguish two sizes of 8 ft tables.
    """
    truth = read_sample_truth(name)
    scene = calibrate_clip(open_clip(truth.path), CalibrateOptions())
    visible = np.isfinite(truth.px[..., 0])
    scale = truth.scene["table"]["length"] / scene.table.length
    miss = scale * scene.camera.to_table(truth.px[visible], scene.table.ball_radius) - truth.xy[visible]
    return scene, float(np.sqrt(np.mean(np.sum(miss**2, axis=-1))))


def test_a_rendered_snooker_clip_is_calibrated_within_five_millimetres() -> None:
    """Its lens bends lines by 2 mm at the corners, which the calibration does not model."""
    scene, error = _calibration_error("snooker_reds")
    assert scene.table.name == read_sample_truth("snooker_reds").table.name
    assert error < 0.005


def test_a_rendered_carom_clip_has_the_limits_of_its_balls() -> None:
    truth = read_sample_truth("carom_match")
    scene, _ = _calibration_error("carom_match")
    radius = scene.table.ball_radius
    matrix = np.array(truth.scene["camera"]["matrix"])
    middles = np.array([[radius, 0.71], [scene.table.length - radius, 0.71], [1.42, radius], [1.42, 1.42 - radius]])
    projected = np.column_stack([middles, np.full(4, radius), np.ones(4)]) @ matrix.T
    expected = projected[:, :2] / projected[:, 2:]
    np.testing.assert_allclose(scene.camera.to_pixels(middles, radius), expected, atol=3)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_rendered_clip_has_the_right_table_and_orientation(name: str) -> None:
    truth = read_sample_truth(name)
    scene, error = _calibration_error(name)
    assert scene.table.name == truth.table.name
    assert error < 0.01
