"""What a calibration determines: the uncertainty of places, and the shape of the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII
from models.physics.billiards.tables import TABLE_PRESETS
from video.calibration.camera_model import PerspectiveFit, build_camera, estimate_place_sigma, estimate_shape
from video.rendering.pinhole_camera import look_at

TABLE = TABLE_PRESETS["pool-9ft"]
PLACES = np.array([[0.3, 0.2], [1.27, 0.6], [2.3, 1.1]])


def test_the_sigma_is_the_scatter_of_places_over_erroneous_calibrations() -> None:
    middle = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
    true = look_at(TABLE, middle + np.array([0.4, 3.0, 3.5]), middle, 1500.0, 1280, 720)
    corners = true.to_pixels(TABLE.corners, NOSE_HEIGHT_RADII * TABLE.ball_radius)
    rng = np.random.default_rng(5)
    factor = rng.normal(0, 0.4, (8, 8))
    covariance, focal_sigma = factor @ factor.T + 0.1 * np.eye(8), 0.08
    px, found = true.to_pixels(PLACES, TABLE.ball_radius), []
    for _ in range(400):
        shifted = corners + rng.multivariate_normal(np.zeros(8), covariance).reshape(4, 2)
        focal = 1500.0 * np.exp(rng.normal(0, focal_sigma))
        camera = build_camera(shifted, covariance, TABLE, PerspectiveFit(focal, focal_sigma, 2.0, 0.0), 1280, 720)
        found.append(camera.to_table(px, TABLE.ball_radius))
    exact = build_camera(corners, covariance, TABLE, PerspectiveFit(1500.0, focal_sigma, 2.0, 0.0), 1280, 720)
    np.testing.assert_allclose(estimate_place_sigma(exact, TABLE, PLACES), np.std(found, axis=0), rtol=0.2)


def test_places_on_a_guessed_table_are_uncertain_by_their_distances_from_the_noses() -> None:
    middle = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
    known = look_at(TABLE, middle + np.array([0.4, 3.0, 3.5]), middle, 1500.0, 1280, 720)
    guessed = estimate_place_sigma(replace(known, scale_sigma=0.1), TABLE, PLACES)
    added = np.sqrt(guessed**2 - estimate_place_sigma(known, TABLE, PLACES) ** 2)
    np.testing.assert_allclose(added, 0.1 * np.minimum(PLACES, [TABLE.length, TABLE.width] - PLACES))


def test_the_shape_of_a_table_is_measured_from_above_and_hardly_from_the_side() -> None:
    skew = np.deg2rad(0.5)
    seen = 400.0 * (TABLE.corners @ np.array([[1.0, 0.0], [np.sin(skew), 1.0]])) + [130.0, 100.0]
    above = estimate_shape(seen, 0.1 * np.eye(8), 1280, 720)
    assert abs(abs(above.angle - 90.0) - 0.5) < 0.05
    assert above.angle_sigma < 0.1
    assert abs(above.aspect - 2.0) < 4 * above.aspect_sigma
    middle = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
    camera = look_at(TABLE, middle + np.array([1.5, 3.0, 1.8]), middle, 1200.0, 1280, 720)
    corners = camera.to_pixels(TABLE.corners, NOSE_HEIGHT_RADII * TABLE.ball_radius)
    aside = estimate_shape(corners, 0.1 * np.eye(8), 1280, 720)
    assert aside.angle_sigma > 10 * above.angle_sigma
    assert abs(aside.angle - 90.0) < 2 * aside.angle_sigma
