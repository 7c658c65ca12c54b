"""Where a rendered scene is seen from: a pinhole camera, its lens error, the rays of its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.scene import Camera, Table, apply_homography
from models.core.typing import FloatArray


def look_at(
    table: Table, eye: FloatArray, target: FloatArray, focal_px: float, width_px: int, height_px: int,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> Camera:  # fmt: skip
    """A camera at `eye` (3,) that looks at `target` (3,), m on the table; `up` points to the top of the picture.

    Straight down needs an `up` along the table, such as (0, -1, 0).
    """
    forward = np.asarray(target, float) - eye
    forward /= np.linalg.norm(forward)
    # the table's frame is left-handed, so right is up x forward by the usual formula
    right = np.cross(up, forward)
    right /= np.linalg.norm(right)
    down = np.cross(right, forward)
    turn = np.stack([right, down, forward])
    inner = np.array([[focal_px, 0, (width_px - 1) / 2], [0, focal_px, (height_px - 1) / 2], [0, 0, 1]])
    matrix = inner @ np.column_stack([turn, -turn @ eye])
    cloth = np.column_stack([matrix[:, 0], matrix[:, 1], matrix[:, 3]])
    corners = apply_homography(cloth, table.corners)
    return Camera(matrix, width_px, height_px, corners, np.zeros((8, 8)), "cloth", float(eye[2]), 0.0)


@dataclass(frozen=True, slots=True)
class Lens:
    """Radial error: r_seen = r (1 + k1 r^2), r from the picture's centre in `unit_px`."""

    k1: float
    centre: FloatArray
    """(2,) px."""
    unit_px: float
    """half a table length."""

    def distort(self, px: FloatArray) -> FloatArray:
        """Pinhole pixels (..., 2) to seen ones."""
        off = px - self.centre
        r2 = np.sum(off**2, axis=-1, keepdims=True) / self.unit_px**2
        seen: FloatArray = self.centre + off * (1 + self.k1 * r2)
        return seen

    def straighten(self, px: FloatArray) -> FloatArray:
        """Seen pixels (..., 2) to pinhole ones, by fixed-point steps (k1 is small)."""
        off = px - self.centre
        straight = off
        for _ in range(6 if self.k1 else 0):
            straight = off / (1 + self.k1 * np.sum(straight**2, axis=-1, keepdims=True) / self.unit_px**2)
        return self.centre + straight


def lens_of(camera: Camera, k1: float) -> Lens:
    """The lens whose unit is half of the longest table side in the picture."""
    sides = np.linalg.norm(np.roll(camera.corners_px, -1, axis=0) - camera.corners_px, axis=1)
    return Lens(k1, np.array([(camera.width_px - 1) / 2, (camera.height_px - 1) / 2]), float(sides.max() / 2))


def rays_of(camera: Camera, lens: Lens, px: FloatArray) -> FloatArray:
    """Unit vectors (..., 3) on the table's axes from the eye through seen pixels (..., 2)."""
    straight = lens.straighten(px)
    homogeneous = np.concatenate([straight, np.ones((*px.shape[:-1], 1))], axis=-1)
    rays: FloatArray = homogeneous @ np.linalg.inv(camera.matrix[:, :3]).T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays


def project(camera: Camera, lens: Lens, xyz: FloatArray) -> FloatArray:
    """Points (..., 3) in m to seen pixels (..., 2)."""
    homogeneous = xyz @ camera.matrix[:, :3].T + camera.matrix[:, 3]
    return lens.distort(homogeneous[..., :2] / homogeneous[..., 2:])
