"""Points that are fixed to rigid bodies: which belong together, the shapes they span, and where the bodies are.

A body that a single point follows is a disc of unknown radius; one that several follow is the convex polygon that they
span, of even density. Places are (x, y, angle), the centre being the polygon's centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from models.core.typing import FloatArray, IntArray

STIFF = 0.02
"""share of its mean by which the distance of two points of one body may change: tracking errs."""
LEAST_AREA = 1e-3
"""of the square of the extent: flatter polygons count as this wide."""


@dataclass(frozen=True, slots=True)
class Bodies:
    """B rigid bodies that N points are fixed to."""

    body: IntArray
    """(N,) which body a point is fixed to."""
    offsets: FloatArray
    """(N, 2) of a point in the frame of its body's centre."""
    corners: FloatArray
    """(B, V, 2) of the polygons in the frame of the centre, in the sense that turns x towards y; padded."""
    count: IntArray
    """(B,) corners of each; 1 for a disc."""
    area: FloatArray
    """(B,) of the polygons, NaN for discs."""
    moment: FloatArray
    """(B,) square of the radius of gyration of the polygons, NaN for discs."""

    @property
    def discs(self) -> NDArray[np.bool_]:
        """(B,)"""
        return np.asarray(self.count == 1, np.bool_)

    @property
    def lever(self) -> FloatArray:
        """(B,) root mean square distance of a body's points from its centre: length of a radian; 0 for discs."""
        squares = np.bincount(self.body, (self.offsets**2).sum(axis=1), len(self.count))
        return np.asarray(np.sqrt(squares / np.bincount(self.body, minlength=len(self.count))), np.float64)

    @property
    def size(self) -> float:
        """Median distance of a polygon's corners from its centre; NaN where all are discs."""
        away = np.linalg.norm(self.corners, axis=2).max(axis=1)[~self.discs]
        return float(np.median(away)) if len(away) else float("nan")

    def points(self, places: FloatArray) -> FloatArray:
        """(..., N, 2) of bodies at places (..., B, 3)."""
        at = places[..., self.body, :]
        return at[..., :2] + turned(self.offsets, at[..., 2])


def turned(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (..., 2) turned by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def groups(x: FloatArray) -> IntArray:
    """(N,) which points move as one body: points x (T, N, 2) all of whose distances stay. Bodies that never move
    against each other cannot be told apart."""
    count = x.shape[1]
    rigid = np.zeros((count, count), np.bool_)
    for i in range(count):
        apart = np.linalg.norm(x - x[:, i : i + 1], axis=2)  # (T, N)
        middle = apart.mean(axis=0)
        rigid[i] = (middle > 0) & (np.ptp(apart, axis=0) < 2 * STIFF * middle)
    # joined where both see nearly the same others as rigid, so that two bodies that touch once stay two
    common = (rigid | np.eye(count, dtype=bool)).astype(float)
    shared = common @ common
    alike = rigid & (shared > 0.5 * np.maximum.outer(shared.diagonal(), shared.diagonal()))
    return np.asarray(connected_components(coo_array(alike), directed=False)[1], np.int64)


def keep_their_distances(x: FloatArray) -> bool:
    """Whether points x (T, n, D) could be fixed to one body; what was not seen (NaN) says nothing."""
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    with np.errstate(invalid="ignore"):
        spread = np.nanmax(apart, axis=0) - np.nanmin(apart, axis=0)
    return bool(np.all(spread <= 2 * STIFF * np.nanmax(apart)))


def assembled(x: FloatArray, body: IntArray) -> tuple[Bodies, FloatArray, float]:
    """Bodies, their places (T, B, 3) and the standard deviation of a coordinate, from points x (T, N, 2) of bodies
    (N,). The deviation is what rigid bodies leave; NaN where there are none. Angles are not wrapped."""
    count = int(body.max()) + 1
    offsets, places = np.zeros(x.shape[1:]), np.zeros((len(x), count, 3))
    left, freedom = 0.0, 0
    shapes = []
    for b in range(count):
        mine = body == b
        shape = _shape(x[:, mine])
        hull, centre, area, moment = _hull(shape)
        offsets[mine] = shape - centre
        shapes.append((hull - centre, area, moment))
        places[:, b] = _placed(x[:, mine], offsets[mine])
        points = int(mine.sum())
        if points > 1:
            found = places[:, b, None, :2] + turned(offsets[mine][None], places[:, b, None, 2])
            left += float(((found - x[:, mine]) ** 2).sum())
            freedom += (len(x) - 1) * (2 * points - 3)
    corners = np.zeros((count, max(len(hull) for hull, _, _ in shapes), 2))
    for b, (hull, _, _) in enumerate(shapes):
        corners[b, : len(hull)] = hull
    counts = np.array([len(hull) for hull, _, _ in shapes])
    bodies = Bodies(body, offsets, corners, counts, *(np.array([shape[k] for shape in shapes]) for k in (1, 2)))
    return bodies, places, float(np.sqrt(left / freedom)) if freedom else float("nan")


def _shape(x: FloatArray) -> FloatArray:
    """(n, 2) mean shape of points x (T, n, 2), turned as in the first frame."""
    shape: FloatArray = x[0] - x[0].mean(axis=0)
    for _ in range(3):
        at = _placed(x, shape - shape.mean(axis=0))
        back = turned(x - at[:, None, :2], -at[:, None, 2])
        shape = np.asarray(back.mean(axis=0), np.float64)
    return shape


def _placed(x: FloatArray, offsets: FloatArray) -> FloatArray:
    """(T, 3) places at which a shape fits points x (T, n, 2) best: Kabsch 1976, doi 10.1107/S0567739476001873."""
    middle, centre = offsets.mean(axis=0), x.mean(axis=1)
    shape, seen = offsets - middle, x - centre[:, None]
    across = (shape[:, 0] * seen[..., 1] - shape[:, 1] * seen[..., 0]).sum(axis=1)
    angle = np.unwrap(np.arctan2(across, (shape * seen).sum(axis=(1, 2))))
    return np.concatenate([centre - turned(middle, angle), angle[:, None]], axis=1)


def _hull(shape: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Corners (n, 2), centre of mass, area and squared radius of gyration of the polygon around points."""
    if len(shape) == 1:
        return shape, shape[0], float("nan"), float("nan")
    try:
        corners = shape[ConvexHull(shape).vertices]
    except QhullError:  # in line
        along = np.linalg.svd(shape - shape.mean(axis=0))[2][0]
        order = np.argsort(shape @ along)
        ends = shape[[order[0], order[-1]]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        return ends, ends.mean(axis=0), LEAST_AREA * length**2, length**2 / 12
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    area = cross.sum() / 2
    centre = ((corners + following) * cross[:, None]).sum(axis=0) / (6 * area)
    a, b = corners - centre, following - centre
    turns = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    second = (turns * ((a * a).sum(axis=1) + (a * b).sum(axis=1) + (b * b).sum(axis=1))).sum() / 12
    return corners, centre, float(area), float(second / area)
