"""Points that are fixed to rigid bodies: their assignment, the shapes of the bodies, and the poses of these.

A body with a single point is a disc of unknown radius; one with several is the convex polygon that they span, of
uniform density. Poses are (x, y, angle) of the polygon's centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from models.core.typing import FloatArray, IntArray

# Relative change of the distance of two points of one body that tracking errors may cause.
MAX_DISTANCE_CHANGE = 0.02
# Least area of a polygon, relative to the square of its extent.
MIN_RELATIVE_AREA = 1e-3


@dataclass(frozen=True, slots=True)
class Bodies:
    """B rigid bodies that N points are fixed to."""

    body: IntArray
    """(N,) body of each point."""
    offsets: FloatArray
    """(N, 2) of a point in the frame of its body's centre."""
    corners: FloatArray
    """(B, V, 2) of the polygons in the frame of the centre, in the sense of rotation from x to y; padded."""
    count: IntArray
    """(B,) corners of each; 1 for a disc."""
    area: FloatArray
    """(B,) of the polygons, NaN for discs."""
    moment: FloatArray
    """(B,) squared radius of gyration of the polygons, NaN for discs."""

    @property
    def discs(self) -> NDArray[np.bool_]:
        """(B,) whether a body is a disc."""
        return np.asarray(self.count == 1, np.bool_)

    @property
    def lever(self) -> FloatArray:
        """(B,) RMS distance of a body's points from its centre: length of a radian; 0 for discs."""
        squares = np.bincount(self.body, (self.offsets**2).sum(axis=1), len(self.count))
        return np.asarray(np.sqrt(squares / np.bincount(self.body, minlength=len(self.count))), np.float64)

    @property
    def size(self) -> float:
        """Median distance of a polygon's farthest corner from its centre; NaN where all are discs."""
        away = np.linalg.norm(self.corners, axis=2).max(axis=1)[~self.discs]
        return float(np.median(away)) if len(away) else float("nan")

    def point_positions(self, places: FloatArray) -> FloatArray:
        """Compute the positions (..., N, 2) of all points of bodies with poses (..., B, 3)."""
        at = places[..., self.body, :]
        return at[..., :2] + rotate_vectors(self.offsets, at[..., 2])


def rotate_vectors(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotate vectors (..., 2) by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def group_rigid_points(x: FloatArray) -> IntArray:
    """Group points whose mutual distances are constant.

    Bodies that never move relative to each other cannot be separated.

    Args:
        x: (T, N, 2) positions.

    Returns:
        (N,) body of each point.
    """
    count = x.shape[1]
    rigid = np.zeros((count, count), np.bool_)
    for i in range(count):
        apart = np.linalg.norm(x - x[:, i : i + 1], axis=2)  # (T, N)
        middle = apart.mean(axis=0)
        rigid[i] = (middle > 0) & (np.ptp(apart, axis=0) < 2 * MAX_DISTANCE_CHANGE * middle)
    # two points are joined if nearly the same points are rigid to both: bodies that touch once stay separate
    common = (rigid | np.eye(count, dtype=bool)).astype(float)
    shared = common @ common
    alike = rigid & (shared > 0.5 * np.maximum.outer(shared.diagonal(), shared.diagonal()))
    return np.asarray(connected_components(coo_array(alike), directed=False)[1], np.int64)


def has_fixed_distances(x: FloatArray) -> bool:
    """Return whether points could be fixed to one body.

    Args:
        x: (T, n, D) positions, NaN where a point was not observed.

    Returns:
        True if no observed distance changes by more than tracking errors.
    """
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    with np.errstate(invalid="ignore"):
        spread = np.nanmax(apart, axis=0) - np.nanmin(apart, axis=0)
    return bool(np.all(spread <= 2 * MAX_DISTANCE_CHANGE * np.nanmax(apart)))


def assemble_bodies(x: FloatArray, body: IntArray) -> tuple[Bodies, FloatArray, float]:
    """Determine shapes and poses of bodies from their points.

    Args:
        x: (T, N, 2) positions of points.
        body: (N,) body of each point.

    Returns:
        The bodies, their poses (T, B, 3) with continuous angles, and the standard deviation of a coordinate: the RMS
        deviation from rigid bodies, NaN where every body has one point.
    """
    count = int(body.max()) + 1
    offsets, places = np.zeros(x.shape[1:]), np.zeros((len(x), count, 3))
    left, freedom = 0.0, 0
    shapes = []
    for b in range(count):
        mine = body == b
        shape = _estimate_shape(x[:, mine])
        hull, centre, area, moment = _polygon_properties(shape)
        offsets[mine] = shape - centre
        shapes.append((hull - centre, area, moment))
        places[:, b] = _fit_poses(x[:, mine], offsets[mine])
        points = int(mine.sum())
        if points > 1:
            predicted = places[:, b, None, :2] + rotate_vectors(offsets[mine][None], places[:, b, None, 2])
            left += float(((predicted - x[:, mine]) ** 2).sum())
            freedom += (len(x) - 1) * (2 * points - 3)
    corners = np.zeros((count, max(len(hull) for hull, _, _ in shapes), 2))
    for b, (hull, _, _) in enumerate(shapes):
        corners[b, : len(hull)] = hull
    counts = np.array([len(hull) for hull, _, _ in shapes])
    bodies = Bodies(body, offsets, corners, counts, *(np.array([shape[k] for shape in shapes]) for k in (1, 2)))
    return bodies, places, float(np.sqrt(left / freedom)) if freedom else float("nan")


def _estimate_shape(x: FloatArray) -> FloatArray:
    """Estimate the mean shape (n, 2) of points x (T, n, 2), in the orientation of the first frame."""
    shape: FloatArray = x[0] - x[0].mean(axis=0)
    for _ in range(3):
        at = _fit_poses(x, shape - shape.mean(axis=0))
        back = rotate_vectors(x - at[:, None, :2], -at[:, None, 2])
        shape = np.asarray(back.mean(axis=0), np.float64)
    return shape


def _fit_poses(x: FloatArray, offsets: FloatArray) -> FloatArray:
    """Fit the poses (T, 3) of a shape to points x (T, n, 2): Kabsch 1976, doi:10.1107/S0567739476001873."""
    middle, centre = offsets.mean(axis=0), x.mean(axis=1)
    shape, observed = offsets - middle, x - centre[:, None]
    across = (shape[:, 0] * observed[..., 1] - shape[:, 1] * observed[..., 0]).sum(axis=1)
    angle = np.unwrap(np.arctan2(across, (shape * observed).sum(axis=(1, 2))))
    return np.concatenate([centre - rotate_vectors(middle, angle), angle[:, None]], axis=1)


def _polygon_properties(shape: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Compute corners (n, 2), centre of mass, area and squared radius of gyration of the convex hull of points."""
    if len(shape) == 1:
        return shape, shape[0], float("nan"), float("nan")
    try:
        corners = shape[ConvexHull(shape).vertices]
    except QhullError:  # collinear points
        along = np.linalg.svd(shape - shape.mean(axis=0))[2][0]
        order = np.argsort(shape @ along)
        ends = shape[[order[0], order[-1]]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        return ends, ends.mean(axis=0), MIN_RELATIVE_AREA * length**2, length**2 / 12
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    area = cross.sum() / 2
    centre = ((corners + following) * cross[:, None]).sum(axis=0) / (6 * area)
    a, b = corners - centre, following - centre
    turns = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    second = (turns * ((a * a).sum(axis=1) + (a * b).sum(axis=1) + (b * b).sum(axis=1))).sum() / 12
    return corners, centre, float(area), float(second / area)
