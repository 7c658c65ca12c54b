"""Circles through partly hidden outlines, and their fusion with the network's positions."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from support.rendered_balls import build_test_scene

from detectors.measurement.circle_fit import smooth_image
from detectors.network.outline_fusion import Surroundings, locate_outlines
from detectors.network.peak_decoding import CandidateDetections
from models.core.scene import Camera, Scene
from video.rendering.pinhole_camera import look_at

CLOTH = (40, 120, 170)
NEAR, FAR = (230, 225, 215), (190, 40, 50)
SUBPIXEL = 8
"""Binary digits of a pixel in which OpenCV takes places."""


def low_scene() -> Scene:
    """A table candidates from 22 degrees over the horizon, across its length."""
    scene = build_test_scene()
    table = scene.table
    middle = np.array([table.length / 2, table.width / 2, 0.0])
    away = np.array([0.0, np.cos(np.radians(22.0)), np.sin(np.radians(22.0))])
    camera: Camera = look_at(table, middle + 5.0 * away, middle, 1500.0, 640, 360)
    return replace(scene, camera=camera)


def image_of(centres: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Discs (n, 2) px on cloth, the nearest last; and the same softened."""
    rgb = np.full((360, 640, 3), CLOTH, np.uint8)
    for (x, y), radius, colour in zip(centres, radii, (FAR, NEAR), strict=False):
        place = (round(x * 2**SUBPIXEL), round(y * 2**SUBPIXEL))
        cv2.circle(rgb, place, round(radius * 2**SUBPIXEL), colour, -1, cv2.LINE_AA, SUBPIXEL)
    rgb = cv2.GaussianBlur(rgb, (0, 0), 0.7)
    return rgb, smooth_image(rgb)


def candidates_at(centres: np.ndarray, radii: np.ndarray, sigma: float) -> CandidateDetections:
    n = len(centres)
    errors, looks = np.full(n, sigma), np.full((n, 4), 0.25)
    return CandidateDetections(centres, radii, np.zeros((n, 2)), np.full(n, 0.9), errors, errors, looks)


def surroundings_of(scene: Scene, radii: np.ndarray) -> Surroundings:
    return Surroundings(radii, np.tile(np.array(CLOTH, float), (len(radii), 1)), np.eye(3), scene)


@pytest.mark.parametrize("aside", [0.0, 0.7, 1.2])
def test_a_ball_behind_another_is_placed_by_the_open_part_of_its_outline(aside: float) -> None:
    scene = low_scene()
    height = scene.table.ball_radius
    far = np.array([1.2, 0.5])
    gap = 2.05 * height
    near = far + np.array([aside * height, np.sqrt(gap**2 - (aside * height) ** 2)])
    truth = scene.camera.to_pixels(np.array([far, near]), height)
    radii = scene.camera.radius_px(np.array([far, near]), height)
    apart = np.linalg.norm(truth[0] - truth[1])
    assert apart < 1.5 * radii.mean()  # one ball hides part of the other
    candidates = candidates_at(truth + np.array([[0.8, -0.6], [-0.5, 0.7]]), radii, 1.5)
    detections, outlines = locate_outlines(*image_of(truth, radii), candidates, surroundings_of(scene, radii), 0)
    assert np.linalg.norm(detections.centre - truth, axis=1).max() < 0.35
    assert (outlines.support > 0.9).all()


def test_a_whole_outline_counts_against_a_network_whose_sigma_is_too_small() -> None:
    scene = build_test_scene()
    truth, radii = np.array([[301.3, 170.6]]), np.array([11.0])
    candidates = candidates_at(truth + np.array([[3.0, -2.0]]), radii, 0.3)
    detections, outlines = locate_outlines(*image_of(truth, radii), candidates, surroundings_of(scene, radii), 0)
    assert outlines.support[0] > 0.9
    assert np.linalg.norm(detections.centre - truth) < 0.6


def test_without_an_outline_the_network_s_position_is_kept() -> None:
    scene = build_test_scene()
    candidates = candidates_at(np.array([[301.3, 170.6]]), np.array([11.0]), 0.7)
    detections, outlines = locate_outlines(
        *image_of(np.empty((0, 2)), np.empty(0)), candidates, surroundings_of(scene, np.array([11.0])), 0
    )
    assert outlines.support[0] == 0
    assert detections.centre[0] == pytest.approx(candidates.centre[0])
    assert detections.sigma[0] == pytest.approx(0.7)
