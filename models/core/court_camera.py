"""A calibrated camera that looks at a court: places in space to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.court import Sport
from models.core.scene import apply_homography
from models.core.typing import FloatArray

# Number of parameters of a camera, see `CourtCamera.parameters`.
CAMERA_PARAMETERS = 8
# Newton steps that undo the distortion of a lens: it is weak, and each step squares the error.
_LENS_STEPS = 5


@dataclass(frozen=True, slots=True)
class CourtCamera:
    """A pinhole camera with a lens, which stands and may turn and zoom.

    The parameters describe a reference image. A camera that turns and zooms about its own centre maps the reference
    image to every frame by a homography, whatever the distance of what it shows.
    """

    parameters: FloatArray
    """(8,) place of the camera (3), m; rotation vector (3) from court axes, with y turned round where they are
    left-handed, to camera axes (x right, y down, z forward); logarithm of the focal length, px; and k1 of the lens:
    r_seen = r (1 + k1 r^2), r from the image centre in half diagonals of the image.
    """
    covariance: FloatArray
    """(8, 8) of the parameters."""
    width_px: int
    height_px: int
    is_left_handed: bool
    """Whether x, y, z of the court are a left-handed system: seen from behind an end."""
    motion: FloatArray | None = None
    """(T, 3, 3) homographies from pixels of the reference image without distortion to those of each frame without
    distortion; None for a camera that does not move.
    """
    first_frame: int = 0
    """Index in the file of the first of these frames."""

    def __post_init__(self) -> None:
        if self.parameters.shape != (CAMERA_PARAMETERS,) or self.covariance.shape != (CAMERA_PARAMETERS,) * 2:
            raise ValueError("a camera of a court needs 8 parameters and their covariance (8, 8)")

    @property
    def centre(self) -> FloatArray:
        """Place (3,) of the camera, m."""
        return self.parameters[:3]

    @property
    def matrix(self) -> FloatArray:
        """(3, 4) projection of (x, y, z, 1), m, to homogeneous pixels of the reference image without distortion."""
        p = self.parameters
        middle = np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])
        focal = np.exp(p[6])
        intrinsic = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
        turn = rotation_matrix(p[3:6])
        if self.is_left_handed:
            turn = turn @ np.diag([1.0, -1.0, 1.0])
        return np.asarray(intrinsic @ turn @ np.column_stack([np.eye(3), -p[:3]]))

    def replace_parameters(self, parameters: FloatArray) -> CourtCamera:
        """Return the camera with other parameters (8,)."""
        return replace(self, parameters=parameters)

    def matrix_of(self, frame: NDArray[np.int64] | int | None) -> FloatArray:
        """Compute the projections (..., 3, 4) of frames (...) by their indices in the file; None for the reference."""
        motion = None if frame is None else self.motion_of(frame)
        return self.matrix if motion is None else np.asarray(motion @ self.matrix)

    def motion_of(self, frame: NDArray[np.int64] | int) -> FloatArray | None:
        """Return the homographies (..., 3, 3) of frames (...) by their indices in the file; None for a static camera.

        Frames before the first one have its motion, and frames after the last one that of the last.
        """
        if self.motion is None:
            return None
        motion: FloatArray = self.motion[np.clip(np.asarray(frame) - self.first_frame, 0, len(self.motion) - 1)]
        return motion

    def to_pixels(self, xyz: FloatArray, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Project places (..., 3), m, to pixels (..., 2) of frames, broadcast against the places.

        Places behind the camera become NaN.
        """
        matrix = self.matrix_of(frame)
        rays = (matrix[..., :3] @ xyz[..., None])[..., 0] + matrix[..., 3]
        depth = np.where(rays[..., 2] > 0, rays[..., 2], np.nan)
        return self.distort(rays[..., :2] / depth[..., None])

    def to_court(self, px: FloatArray, z: float = 0.0, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Find the places (..., 3), m, at height `z` that are seen at pixels (..., 2) of frames."""
        matrix = self.matrix_of(frame)
        plane = np.concatenate([matrix[..., :2], (matrix[..., 2] * z + matrix[..., 3])[..., None]], axis=-1)
        xy = apply_homography(np.linalg.inv(plane), self.undistort(px))
        return np.concatenate([xy, np.full((*xy.shape[:-1], 1), z)], axis=-1)

    def rays(self, px: FloatArray, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Compute the unit vectors (..., 3) from the camera's place towards what is seen at pixels (..., 2)."""
        matrix, flat = self.matrix_of(frame), self.undistort(px)
        ahead = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
        along = np.linalg.solve(matrix[..., :3], ahead[..., None])[..., 0]
        return np.asarray(along / np.linalg.norm(along, axis=-1, keepdims=True))

    def distort(self, px: FloatArray) -> FloatArray:
        """Move pixels (..., 2) from where a lens without distortion shows them to where they are seen."""
        middle, half = self._lens()
        off = (px - middle) / half
        return np.asarray(middle + half * off * (1 + self.parameters[7] * (off**2).sum(-1, keepdims=True)))

    def undistort(self, px: FloatArray) -> FloatArray:
        """Move seen pixels (..., 2) to where a lens without distortion would show them."""
        middle, half = self._lens()
        off = (px - middle) / half
        r_seen = np.linalg.norm(off, axis=-1, keepdims=True)
        r, k1 = r_seen, self.parameters[7]
        for _ in range(_LENS_STEPS):
            r = r - (r * (1 + k1 * r**2) - r_seen) / (1 + 3 * k1 * r**2)
        return np.asarray(middle + half * off * np.where(r_seen > 0, r / np.where(r_seen > 0, r_seen, 1.0), 1.0))

    def _lens(self) -> tuple[FloatArray, float]:
        """Return the centre (2,) of the image and half its diagonal, px."""
        size = np.array([self.width_px, self.height_px], np.float64)
        return (size - 1) / 2, float(np.linalg.norm(size)) / 2


def rotation_matrix(vector: FloatArray) -> FloatArray:
    """Compute the rotation (3, 3) about a vector (3,) by its length in rad (Rodrigues 1840)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


@dataclass(frozen=True, slots=True)
class CourtScene:
    """A court and the camera that looks at it."""

    sport: Sport
    camera: CourtCamera
    line_error: float
    """px, root mean square distance of the painted lines that were found from where the camera puts them."""
    notes: tuple[str, ...] = ()
    """Codes of irregularities."""

    def __post_init__(self) -> None:
        # This camera, not the usual one of the sport, decides which ends are near or left.
        sport = replace(self.sport, is_filmed_from_side=not self.camera.is_left_handed)
        object.__setattr__(self, "sport", sport)
