"""Balls of still images of every size: nets, sets and the scale of the balls."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.shared_material import find_shared_file
from support.table_images import TableColours, draw_table, look_at_table

from detectors.detect import build_detector
from detectors.detect_options import DetectOptions
from detectors.measurement.cloth_background import learn_cloth_background
from detectors.measurement.working_view import build_view
from detectors.still_images import detect_in_still
from models.core.scene import Scene
from models.physics.billiards.tables import TABLE_PRESETS
from pipeline.io.image_file import read_image
from video.io.video_options import CalibrateOptions

KINDS = {"red": 9, "cue": 1, "yellow": 1, "green": 1, "brown": 1, "blue": 1, "pink": 1, "black": 1}


@pytest.mark.parametrize(("width", "turns"), [(1280, 0), (4032, 0), (8000, 0), (1280, 1)])
def test_a_sharp_photograph_gives_all_balls_at_every_size_and_turned(width: int, turns: int) -> None:
    image = read_image(find_shared_file("clips_to_refuse_or_survive/still_snooker.jpg"))
    height = round(width * image.shape[0] / image.shape[1])
    scaled = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if width < 4032 else cv2.INTER_CUBIC)
    turned = np.ascontiguousarray(np.rot90(np.asarray(scaled, np.uint8), turns))
    balls = detect_in_still(turned, "still", DetectOptions(), CalibrateOptions())
    assert {kind: balls.kind.count(kind) for kind in balls.kind} == KINDS
    assert np.ptp(balls.radius) < 0.25 * np.median(balls.radius)


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_nets_of_the_side_pockets_are_no_balls_wherever_they_hang_along_the_cushion(shift: float) -> None:
    home = TABLE_PRESETS["home-4ft"]
    middle = np.array([home.length / 2, home.width / 2, 0.0])
    camera = look_at_table(home, 1000.0, (1280, 720), middle + np.array([0.0, 0.0, 1.4]), middle, 0.0)
    image, rng = draw_table(replace(home, pockets=False), camera, TableColours()), np.random.default_rng(2)
    nets = home.pocket_centres + np.array([shift * home.ball_radius, 0.0])
    for net in [*nets[[1, 4]], *home.pocket_centres[[0, 2, 3, 5]]]:
        x, y = np.rint(camera.to_pixels(net, 0.0)).astype(int).tolist()
        reach = round(1.7 * float(camera.radius_px(net, home.ball_radius)))
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.circle(mask, (x, y), reach, 255, -1, cv2.LINE_AA)
        threads = np.full_like(image, 60)
        for _ in range(25):
            one, two = np.array([x, y]) + rng.integers(-reach, reach, (2, 2))
            cv2.line(threads, tuple(one.tolist()), tuple(two.tolist()), (225, 225, 220), 2, cv2.LINE_AA)
        image = np.where(mask[..., None] > 127, threads, image)
    lab = cv2.cvtColor((np.array([[[30, 140, 90]]]) / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0, 0]
    scene = Scene(home, camera, lab.astype(np.float64), ())
    view = build_view(scene)
    cloth = learn_cloth_background([view.working_image(image)], view)
    inwards = np.array([[0.0, 0.3], [0.0, -0.3]]) * home.ball_radius
    centre = view.to_working(camera.to_pixels(nets[[1, 4]] + inwards, home.ball_radius))
    radius = np.full(2, view.median_radius)
    shade = np.asarray(0.8 * view.working_image(image), np.uint8)
    dropped = view.working_image(image)
    for place in np.rint(centre).astype(int).tolist():
        cv2.circle(dropped, tuple(place), round(view.median_radius), (230, 120, 20), -1)
    assert cloth.is_lining(view.working_image(image), centre, radius).all()
    assert cloth.is_lining(shade, centre, radius).all(), "a player's shade moves no net"
    assert not cloth.is_lining(dropped, centre, radius).any(), "a ball that drops is seen"


def test_a_net_over_a_hole_is_no_ball_and_a_ball_beside_the_hole_is_one() -> None:
    home = TABLE_PRESETS["home-4ft"]
    middle = np.array([home.length / 2, home.width / 2, 0.0])
    camera = look_at_table(home, 1300.0, (1280, 720), middle + np.array([0.0, 0.0, 1.4]), middle, 0.0)
    hole, ball = 2.9 * home.ball_radius, home.ball_radius
    image = draw_table(replace(home, pockets=False), camera, TableColours())
    for corner in home.pocket_centres[[0, 2, 3, 5]]:
        x, y = np.rint(camera.to_pixels(corner, 0.0)).astype(int).tolist()
        cv2.circle(image, (x, y), round(float(hole / ball * camera.radius_px(corner, ball))), (20, 15, 12), -1)
    inside, outside = np.array([1.4, 1.4]) * ball, np.array([2.9, 2.9]) * ball
    for place in (inside, outside):
        x, y = np.rint(camera.to_pixels(place, ball)).astype(int).tolist()
        for share, level in ((1.0, 170), (0.8, 200), (0.5, 225)):  # shaded: a disc of one level is drawn, no ball
            cv2.circle(
                image, (x, y), round(share * float(camera.radius_px(place, ball))), (level,) * 3, -1, cv2.LINE_AA
            )
    lab = cv2.cvtColor((np.array([[[30, 140, 90]]]) / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0, 0]
    scene = Scene(home, camera, lab.astype(np.float64), ())
    view = build_view(scene)
    cloth = learn_cloth_background([view.working_image(image)], view)
    centre = view.to_working(camera.to_pixels(np.array([inside, outside]), ball))
    assert cloth.is_lining(view.working_image(image), centre, np.full(2, view.median_radius)).tolist() == [True, False]
    for detector in ("onnx", "hough"):
        found = build_detector(scene, [(0, image)], DetectOptions(detector=detector), is_still=True).detect(image)
        np.testing.assert_allclose(camera.to_table(found.centre, ball), outside[None], atol=0.2 * ball)
