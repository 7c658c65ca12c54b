"""Viewpoint of a rendered scene: pinhole camera, lens distortion, rays of its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import Camera, Table, apply_homography
from models.core.typing import FloatArray


def look_at(
    table: Table, eye: FloatArray, target: FloatArray, focal_px: float, width_px: int, height_px: int,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> Camera:  # fmt: skip
    """Build a camera at a position that looks at a target.

    Args:
        eye: (3,) m, camera position.
        target: (3,) m, point on the table at the image centre.
        focal_px: focal length, px.
        width_px: width of the image.
        height_px: height of the image.
        up: direction to the top of the image. A view straight down needs one along the table, such as (0, -1, 0).

    Returns:
        The camera, exact and without lens distortion.
    """
    forward = np.asarray(target, float) - eye
    forward /= np.linalg.norm(forward)
    # the table's frame is left-handed, so right is up x forward by the usual formula
    right = np.cross(up, forward)
    right /= np.linalg.norm(right)
    down = np.cross(right, forward)
    rotation = np.stack([right, down, forward])
    intrinsics = np.array([[focal_px, 0, (width_px - 1) / 2], [0, focal_px, (height_px - 1) / 2], [0, 0, 1]])
    matrix = intrinsics @ np.column_stack([rotation, -rotation @ eye])
    cloth = np.column_stack([matrix[:, 0], matrix[:, 1], matrix[:, 3]])
    corners = apply_homography(cloth, table.corners)
    return Camera(matrix, width_px, height_px, corners, np.zeros((8, 8)), "cloth", float(eye[2]), 0.0)


@dataclass(frozen=True, slots=True)
class Lens:
    """Radial distortion: r_distorted = r (1 + k1 r^2), r from the image centre in units of `unit_px`."""

    k1: float
    centre: FloatArray
    """(2,) px."""
    unit_px: float
    """Half a table length."""

    def distort(self, px: FloatArray) -> FloatArray:
        """Map pinhole pixels (..., 2) to distorted ones."""
        off = px - self.centre
        r2 = np.sum(off**2, axis=-1, keepdims=True) / self.unit_px**2
        distorted: FloatArray = self.centre + off * (1 + self.k1 * r2)
        return distorted

    def undistort(self, px: FloatArray) -> FloatArray:
        """Map distorted pixels (..., 2) to pinhole ones, by fixed-point iteration (k1 is small)."""
        off = px - self.centre
        straight = off
        for _ in range(6 if self.k1 else 0):
            straight = off / (1 + self.k1 * np.sum(straight**2, axis=-1, keepdims=True) / self.unit_px**2)
        return self.centre + straight


def make_lens(camera: Camera, k1: float) -> Lens:
    """Make the lens whose unit is half of the longest table side in the image."""
    sides = np.linalg.norm(np.roll(camera.corners_px, -1, axis=0) - camera.corners_px, axis=1)
    return Lens(k1, np.array([(camera.width_px - 1) / 2, (camera.height_px - 1) / 2]), float(sides.max() / 2))


def pixel_rays(camera: Camera, lens: Lens, px: FloatArray) -> FloatArray:
    """Return unit vectors (..., 3) on the table's axes from the camera through distorted pixels (..., 2)."""
    straight = lens.undistort(px)
    homogeneous = np.concatenate([straight, np.ones((*px.shape[:-1], 1))], axis=-1)
    rays: FloatArray = homogeneous @ np.linalg.inv(camera.matrix[:, :3]).T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays


def project_points(camera: Camera, lens: Lens, xyz: FloatArray) -> FloatArray:
    """Project points to distorted pixels.

    Args:
        camera: the pinhole camera.
        lens: its distortion.
        xyz: (..., 3) m.

    Returns:
        Pixels (..., 2).
    """
    homogeneous = xyz @ camera.matrix[:, :3].T + camera.matrix[:, 3]
    return lens.distort(homogeneous[..., :2] / homogeneous[..., 2:])
