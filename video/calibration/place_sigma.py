"""Uncertainty of places on a table that comes from the calibration of its camera."""

from __future__ import annotations

import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII, Camera, Table, apply_homography
from models.core.typing import FloatArray
from video.calibration.camera_model import homography_between

STEP_PX = 0.5
"""px, step of the numerical derivatives by the corners."""


def estimate_place_sigma(camera: Camera, table: Table, xy: FloatArray) -> FloatArray:
    """Estimate the standard deviation of places relative to the noses.

    It has two parts: the corners, through the homography of their plane, and the height of the camera, which shifts the
    centres of the balls against the plane of the corners.

    Args:
        camera: Camera that was calibrated by the corners of the table.
        table: The table.
        xy: Centres of balls (N, 2), m.

    Returns:
        Standard deviations (N, 2) of x and y, m.
    """
    z = table.ball_radius
    px = camera.to_pixels(xy, z)
    base = _map_by_corners(camera.corners_px, table, px)
    columns = []
    for k in range(8):
        corners = camera.corners_px.ravel().copy()
        corners[k] += STEP_PX
        columns.append((_map_by_corners(corners.reshape(4, 2), table, px) - base) / STEP_PX)
    jacobian = np.stack(columns, axis=-1)  # (N, 2, 8)
    variance = np.einsum("nij,jk,nik->ni", jacobian, camera.corner_covariance, jacobian)
    plane = NOSE_HEIGHT_RADII * table.ball_radius if camera.plane == "noses" else 0.0
    eye = camera.position
    parallax = abs(plane - z) * np.abs(xy - eye[:2]) / max(abs(float(eye[2])), z) ** 2
    return np.asarray(np.sqrt(variance + (parallax * camera.height_sigma) ** 2))


def _map_by_corners(corners: FloatArray, table: Table, px: FloatArray) -> FloatArray:
    """Map pixels (N, 2) to the plane of corners (4, 2) px, m."""
    return apply_homography(homography_between(corners, table.corners), px)
