"""The table and the camera that looks at it: what turns pixels into metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

Game = Literal["pool", "snooker", "carom"]

CUSHIONS = ("left", "right", "top", "bottom")
POCKETS = ("top-left", "top", "top-right", "bottom-left", "bottom", "bottom-right")

NOSE_HEIGHT_RADII = 1.27
"""Height of the cushion nose above the cloth, in ball radii (WPA rules: 63.5 % of the diameter)."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table and its balls; lengths in metres between the cushion noses.

    x runs along `length`, y along `width`; the origin is a corner of the nose rectangle.
    """

    name: str
    game: Game
    length: float
    width: float
    ball_radius: float
    ball_mass: float
    pockets: bool

    def __post_init__(self) -> None:
        if not 0 < self.width <= self.length:
            raise ValueError(f"a table is at least as long as wide, both above 0 m; got {self.length} x {self.width} m")
        if not 0 < self.ball_radius < self.width / 4:
            raise ValueError(f"a ball radius in metres is needed, such as 0.028575; got {self.ball_radius}")

    @property
    def corners(self) -> FloatArray:
        """Corners of the nose rectangle (4, 2) in m: top-left, top-right, bottom-right, bottom-left."""
        length, width = self.length, self.width
        return np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])

    @property
    def pocket_centres(self) -> FloatArray:
        """Where the pockets are (6, 2) in m, in the order of `POCKETS`; empty (0, 2) without pockets."""
        if not self.pockets:
            return np.empty((0, 2))
        length, width = self.length, self.width
        half = length / 2
        return np.array([[0.0, 0.0], [half, 0.0], [length, 0.0], [0.0, width], [half, width], [length, width]])


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera above a table.

    `matrix` (3, 4) takes (x, y, z, 1), metres, z the height above the cloth, to homogeneous pixels of the
    *reference picture*. `motion` (T, 3, 3), if given, takes pixels of the reference picture to pixels of
    frame T: a camera that drifts. `corner_covariance` (8, 8) in px^2 is that of the four corners
    (x, y of each, in the order of `Table.corners`) which the matrix was computed from.
    """

    matrix: FloatArray
    width_px: int
    height_px: int
    corners_px: FloatArray
    corner_covariance: FloatArray
    plane: Literal["cloth", "noses"]
    height: float
    height_sigma: float
    motion: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 4):
            raise ValueError(f"a camera matrix is 3 x 4; got {self.matrix.shape}")
        if self.corners_px.shape != (4, 2) or self.corner_covariance.shape != (8, 8):
            raise ValueError("a camera needs four corners (4, 2) and their covariance (8, 8)")

    def homography(self, z: float) -> FloatArray:
        """Plane at height z (m) above the cloth to reference pixels, (3, 3)."""
        m, plane = self.matrix, np.empty((3, 3))
        plane[:, :2], plane[:, 2] = m[:, :2], m[:, 2] * z + m[:, 3]
        return plane

    def to_pixels(self, xy: FloatArray, z: float, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Points (..., 2) in m at height z to pixels (..., 2), of the reference picture or of `frame` (...)."""
        px = apply_homography(self.homography(z), xy)
        if self.motion is None or frame is None:
            return px
        return apply_homography(self.motion[frame], px)

    def to_table(self, px: FloatArray, z: float, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Pixels (..., 2) to points (..., 2) in m on the plane at height z."""
        if self.motion is not None and frame is not None:
            px = apply_homography(_inverse(self.motion[frame]), px)
        return apply_homography(_inverse(self.homography(z)), px)

    def metres_per_pixel(self, xy: FloatArray, z: float) -> FloatArray:
        """d(x, y)/d(px) at table points (..., 2): Jacobians (..., 2, 2) in m/px."""
        return _inverse(homography_jacobian(self.homography(z), xy))

    def radius_px(self, xy: FloatArray, radius: float) -> FloatArray:
        """Mean seen radius (...) in px of a ball that rests at (..., 2) m."""
        jacobian = homography_jacobian(self.homography(radius), xy)
        radii: FloatArray = radius * np.sqrt(np.abs(np.linalg.det(jacobian)) / self._foreshortening(xy, radius))
        return radii

    def _foreshortening(self, xy: FloatArray, z: float) -> FloatArray:
        """Cosine between the line of sight and the vertical at points (..., 2), in (0, 1]."""
        eye = self.eye
        ray = np.concatenate([eye[:2] - xy, np.broadcast_to(eye[2] - z, (*xy.shape[:-1], 1))], axis=-1)
        cosine: FloatArray = np.abs(ray[..., 2]) / np.linalg.norm(ray, axis=-1)
        return cosine

    @property
    def eye(self) -> FloatArray:
        """Where the camera stands (3,), in m above the table."""
        return np.asarray(np.linalg.solve(self.matrix[:, :3], -self.matrix[:, 3]), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Scene:
    """A table seen by a camera, with the colour of its cloth and what the search for it has to say."""

    table: Table
    camera: Camera
    cloth_lab: FloatArray
    """CIE L*a*b* of the cloth (3,)."""
    notes: tuple[str, ...]
    """Sentences for the user: how the table was found, what was assumed."""
    doubts: tuple[str, ...] = ()
    """Those among them that say what may be wrong, so that no result deserves full trust before it is settled."""


def apply_homography(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Map points (..., 2) by homographies (..., 3, 3), broadcast against each other."""
    h = homography
    x, y = points[..., 0], points[..., 1]
    w = h[..., 2, 0] * x + h[..., 2, 1] * y + h[..., 2, 2]
    u = h[..., 0, 0] * x + h[..., 0, 1] * y + h[..., 0, 2]
    v = h[..., 1, 0] * x + h[..., 1, 1] * y + h[..., 1, 2]
    return np.stack([u / w, v / w], axis=-1)


def homography_jacobian(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Jacobians (..., 2, 2) of a homography (3, 3) at points (..., 2)."""
    mapped = apply_homography(homography, points)
    w = points @ homography[2, :2] + homography[2, 2]
    linear = homography[:2, :2] - mapped[..., :, None] * homography[2, :2]
    jacobian: FloatArray = linear / w[..., None, None]
    return jacobian


def _inverse(matrices: FloatArray) -> FloatArray:
    """Inverses of square matrices (..., n, n)."""
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
