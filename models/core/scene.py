"""Table, ball size and calibrated camera: the conversion between pixels and metres."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

Game = Literal["pool", "snooker", "carom"]
BallSizeSource = Literal["user", "preset", "image", "contacts", "combined"]

CUSHIONS = ("left", "right", "top", "bottom")
POCKETS = ("top-left", "top", "top-right", "bottom-left", "bottom", "bottom-right")

# Height of the cushion nose above the cloth, in ball radii (WPA rules: 63.5 % of the diameter).
NOSE_HEIGHT_RADII = 1.27

# Standardized difference above which two estimates contradict: 0.3 % of agreeing pairs exceed it by chance, and a clip
# has at most three pairs.
CONTRADICTION_SIGMAS = 3.0
# Relative difference below which two estimates never contradict. The smallest step between balls on the market is 3 %
# (snooker to blackball), and on 14 clips with known balls the images were wrong by up to 2.9 %.
CONTRADICTION_SHARE = 0.03


@dataclass(frozen=True, slots=True)
class Table:
    """Dimensions of a table and its balls.

    Table coordinates are in metres. The origin is the top-left corner of the rectangle between the noses. x runs
    along `length`, y along `width`; z is the height above the cloth.
    """

    name: str
    """Name in the table catalogue, e.g. `pool-9ft`."""
    game: Game
    """Family of games, which decides on the ball classes."""
    length: float
    """m, between the noses of the short cushions."""
    width: float
    """m, between the noses of the long cushions."""
    ball_radius: float
    """m."""
    ball_mass: float
    """kg."""
    pockets: bool
    """Whether the table has pockets."""

    def __post_init__(self) -> None:
        if not 0 < self.width <= self.length:
            raise ValueError(f"a table is at least as long as wide, both above 0 m; got {self.length} x {self.width} m")
        if not 0 < self.ball_radius < self.width / 4:
            raise ValueError(f"a ball radius in metres is needed, such as 0.028575; got {self.ball_radius}")

    @property
    def corners(self) -> FloatArray:
        """Corners (4, 2) of the nose rectangle in m: top-left, top-right, bottom-right, bottom-left."""
        length, width = self.length, self.width
        return np.array([[0.0, 0.0], [length, 0.0], [length, width], [0.0, width]])

    @property
    def pocket_centres(self) -> FloatArray:
        """Centres (6, 2) of the pockets in m, in the order of `POCKETS`; (0, 2) for a table without pockets."""
        if not self.pockets:
            return np.empty((0, 2))
        length, width = self.length, self.width
        half = length / 2
        return np.array([[0.0, 0.0], [half, 0.0], [length, 0.0], [0.0, width], [half, width], [length, width]])


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated pinhole camera above a table.

    The calibration refers to a reference image; `motion` maps it to every frame if the camera moves.
    """

    matrix: FloatArray
    """(3, 4) projection of table coordinates (x, y, z, 1), m, to homogeneous pixels of the reference image."""
    width_px: int
    """Width of the frames, px."""
    height_px: int
    """Height of the frames, px."""
    corners_px: FloatArray
    """(4, 2) px, located corners of the table, in the order of `Table.corners`."""
    corner_covariance: FloatArray
    """(8, 8) px^2, covariance of x and y of the four corners."""
    plane: Literal["cloth", "noses"]
    """Plane in which the corners were located: the cloth, or the height of the cushion noses."""
    height: float
    """m, height of the camera above the cloth."""
    height_sigma: float
    """m, standard deviation of `height`."""
    motion: FloatArray | None = None
    """(T, 3, 3) homographies from pixels of the reference image to pixels of each frame; None for a static camera."""
    first_frame: int = 0
    """Index in the file of the first of these frames."""
    scale_sigma: float = 0.0
    """Relative standard deviation of all lengths where the size of the table is a guess; 0 where it is known."""

    def __post_init__(self) -> None:
        if self.matrix.shape != (3, 4):
            raise ValueError(f"a camera matrix is 3 x 4; got {self.matrix.shape}")
        if self.corners_px.shape != (4, 2) or self.corner_covariance.shape != (8, 8):
            raise ValueError("a camera needs four corners (4, 2) and their covariance (8, 8)")

    def homography(self, z: float) -> FloatArray:
        """Compute the homography (3, 3) from the plane at height z (m) to pixels of the reference image."""
        m, plane = self.matrix, np.empty((3, 3))
        plane[:, :2], plane[:, 2] = m[:, :2], m[:, 2] * z + m[:, 3]
        return plane

    def motion_of(self, frame: NDArray[np.int64] | int) -> FloatArray | None:
        """Return the homographies (..., 3, 3) of frames (...) by their indices in the file; None for a static camera.

        Frames before the first one have its motion, and frames after the last one that of the last.
        """
        if self.motion is None:
            return None
        motion: FloatArray = self.motion[np.clip(np.asarray(frame) - self.first_frame, 0, len(self.motion) - 1)]
        return motion

    def to_pixels(self, xy: FloatArray, z: float, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Project points of the table to pixels.

        Args:
            xy: Points (..., 2), m.
            z: Height of the points above the cloth, m.
            frame: Frame indices, broadcast against the points; None for the reference image.

        Returns:
            Pixels (..., 2).
        """
        px = apply_homography(self.homography(z), xy)
        motion = None if frame is None else self.motion_of(frame)
        return px if motion is None else apply_homography(motion, px)

    def to_table(self, px: FloatArray, z: float, frame: NDArray[np.int64] | int | None = None) -> FloatArray:
        """Map pixels to points on a horizontal plane above the table.

        Args:
            px: Pixels (..., 2).
            z: Height of the plane above the cloth, m.
            frame: Frame indices, broadcast against the pixels; None for the reference image.

        Returns:
            Points (..., 2), m.
        """
        motion = None if frame is None else self.motion_of(frame)
        if motion is not None:
            px = apply_homography(_invert_matrices(motion), px)
        return apply_homography(_invert_matrices(self.homography(z)), px)

    def metres_per_pixel(self, xy: FloatArray, z: float) -> FloatArray:
        """Evaluate the Jacobians (..., 2, 2), m/px, of table position by pixel.

        Args:
            xy: Points (..., 2), m.
            z: Height of the points above the cloth, m.

        Returns:
            Jacobians for the reference image.
        """
        return _invert_matrices(homography_jacobian(self.homography(z), xy))

    def radius_px(self, xy: FloatArray, radius: float) -> FloatArray:
        """Predict the mean radius of balls in the reference image.

        Args:
            xy: Centres (..., 2) of resting balls, m.
            radius: Radius of the balls, m.

        Returns:
            Radii (...), px.
        """
        jacobian = homography_jacobian(self.homography(radius), xy)
        radii: FloatArray = radius * np.sqrt(np.abs(np.linalg.det(jacobian)) / self._viewing_angle_cosine(xy, radius))
        return radii

    def _viewing_angle_cosine(self, xy: FloatArray, z: float) -> FloatArray:
        """Compute the cosine (...) between line of sight and vertical at points (..., 2) at height z; in (0, 1]."""
        eye = self.position
        ray = np.concatenate([eye[:2] - xy, np.broadcast_to(eye[2] - z, (*xy.shape[:-1], 1))], axis=-1)
        cosine: FloatArray = np.abs(ray[..., 2]) / np.linalg.norm(ray, axis=-1)
        return cosine

    @property
    def position(self) -> FloatArray:
        """Optical centre (3,) of the camera in table coordinates, m."""
        return np.asarray(np.linalg.solve(self.matrix[:, :3], -self.matrix[:, 3]), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class BallSize:
    """An estimate of the radius of the balls."""

    radius: float
    """m."""
    sigma: float
    """m, standard deviation of `radius`."""
    source: BallSizeSource
    """`user`: typed; `preset`: nominal size of the table's balls; `image`: apparent size; `contacts`: distance at which
    balls touch; `combined`: nominal size that the images confirm."""

    def __post_init__(self) -> None:
        if not (self.radius > 0 and self.sigma >= 0):
            raise ValueError(f"a ball size needs a radius above 0 m and a sigma; got {self.radius} ± {self.sigma} m")


@dataclass(frozen=True, slots=True)
class Scene:
    """Result of the calibration of a clip: table, camera, colour of the cloth, and notes for the user."""

    table: Table
    """Dimensions of the table and its balls."""
    camera: Camera
    """Calibrated camera."""
    cloth_lab: FloatArray
    """(3,) CIE L*a*b* colour of the cloth."""
    notes: tuple[str, ...]
    """Sentences for the user: how the table was located, and which assumptions were made."""
    warnings: tuple[str, ...] = ()
    """Those notes that name a possible error. A result with warnings has at best the trust level amber."""
    ball_size_estimates: tuple[BallSize, ...] = ()
    """Independent estimates of the size of the balls; empty where only the table states it."""

    def __post_init__(self) -> None:
        if self.ball_size.radius != self.table.ball_radius:
            raise ValueError(
                f"the balls of table and estimates are equally large; got {self.table.ball_radius} and"
                f" {self.ball_size.radius} m"
            )

    @property
    def ball_size(self) -> BallSize:
        """The estimate of the ball size that all stages use; its radius is that of the table."""
        if not self.ball_size_estimates:
            return BallSize(self.table.ball_radius, 0.0, "preset")
        return combine_ball_sizes(self.ball_size_estimates)


def find_contradictions(estimates: Sequence[BallSize]) -> list[tuple[BallSize, BallSize]]:
    """Find the pairs of independent estimates that contradict.

    Args:
        estimates: Independent estimates.

    Returns:
        Pairs that differ by more than `CONTRADICTION_SIGMAS` standard deviations and by more than the share
        `CONTRADICTION_SHARE`, in the order of the estimates.
    """
    return [pair for pair in combinations(estimates, 2) if _contradict(*pair)]


def _contradict(one: BallSize, two: BallSize) -> bool:
    difference = abs(math.log(one.radius / two.radius))
    sigma = math.hypot(one.sigma / one.radius, two.sigma / two.radius)
    return difference > math.log1p(CONTRADICTION_SHARE) and difference > CONTRADICTION_SIGMAS * sigma


def combine_ball_sizes(estimates: Sequence[BallSize]) -> BallSize:
    """Combine independent estimates to the one that all stages use.

    Sizes on the market are discrete: a mean of a nominal and an apparent size is a ball that nobody makes. So a nominal
    size that the images confirm is kept unchanged; if they contradict it, the images win over a preset, because the
    contacts need the size relative to the calibrated table, but not over the user.

    Args:
        estimates: A `user` or `preset` estimate, and an `image` estimate if there is one.

    Returns:
        The estimate.

    Raises:
        ValueError: There is no estimate, or only one from contacts.
    """
    by_source = {estimate.source: estimate for estimate in estimates}
    nominal, apparent = by_source.get("user", by_source.get("preset")), by_source.get("image")
    if nominal is None and apparent is None:
        raise ValueError("a ball size needs an estimate from the user, a preset or the images")
    if nominal is None or apparent is None:
        return nominal or apparent  # type: ignore[return-value]
    if nominal.source == "user":
        return nominal
    # A preset that is one of several candidates has a wide sigma: a guess confirms nothing that was measured better.
    as_sure = replace(nominal, sigma=min(nominal.sigma, apparent.sigma))
    return apparent if find_contradictions([as_sure, apparent]) else replace(nominal, source="combined")


def apply_homography(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Map points by homographies.

    Args:
        homography: Homographies (..., 3, 3), broadcast against the points.

    Returns:
        Mapped points (..., 2).
    """
    h = homography
    x, y = points[..., 0], points[..., 1]
    w = h[..., 2, 0] * x + h[..., 2, 1] * y + h[..., 2, 2]
    u = h[..., 0, 0] * x + h[..., 0, 1] * y + h[..., 0, 2]
    v = h[..., 1, 0] * x + h[..., 1, 1] * y + h[..., 1, 2]
    return np.stack([u / w, v / w], axis=-1)


def homography_jacobian(homography: FloatArray, points: FloatArray) -> FloatArray:
    """Evaluate the Jacobians of a homography.

    Returns:
        Jacobians (..., 2, 2) of mapped point by point.
    """
    mapped = apply_homography(homography, points)
    w = points @ homography[2, :2] + homography[2, 2]
    linear = homography[:2, :2] - mapped[..., :, None] * homography[2, :2]
    jacobian: FloatArray = linear / w[..., None, None]
    return jacobian


def _invert_matrices(matrices: FloatArray) -> FloatArray:
    """Invert square matrices (..., M, M)."""
    return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
